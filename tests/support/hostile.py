"""A service as an attacker would run it: a real one's answers, with what terminals obey in every
text of them."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

EVIL = "\x1b[2J[red]x[/]\x9b31m\x1b]0;owned\x07\r\x7f\u202e\u2028\u2066\ttab\nnext"
OBEYED = set(
    map(
        chr,
        [
            *range(32),
            *range(127, 160),
            0x2028,
            0x2029,
            *range(0x202A, 0x202F),
            *range(0x2066, 0x206A),
        ],
    )
) - {"\n", "\t"}


def spoiled(value: Any) -> Any:
    """JSON with every text in it begun by what terminals obey."""
    if isinstance(value, str):
        return EVIL + value
    if isinstance(value, list):
        return [spoiled(x) for x in value]
    if isinstance(value, dict):
        return {
            key: x if key == "next" else spoiled(x) for key, x in value.items()
        }  # a list of many pages has to end
    return value


@contextmanager
def hostile(port: int) -> Iterator[str]:
    """The address of a server that asks the one on this port, and answers with its JSON spoiled."""

    class Asked(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
            connection.request(
                self.command,
                self.path,
                body,
                {k: v for k, v in self.headers.items() if k.lower() != "host"},
            )
            answer = connection.getresponse()
            content = answer.read()
            connection.close()
            if "json" in answer.headers.get("Content-Type", ""):
                content = json.dumps(spoiled(json.loads(content))).encode()
            self.send_response(answer.status)
            self.send_header("Content-Type", answer.headers.get("Content-Type", ""))
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_POST = do_PUT = do_GET  # noqa: N815  (names that http.server looks for)

        def log_message(self, *_: Any) -> None:
            return

    with ThreadingHTTPServer(("127.0.0.1", 0), Asked) as server:
        serving = threading.Thread(target=server.serve_forever, args=(0.05,))
        serving.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            serving.join()
