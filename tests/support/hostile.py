"""A hostile service: a real one's answers, with terminal control sequences in every text."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

EVIL = "\x1b[2J[red]x[/]\x9b31m\x1b]0;owned\x07\r\x7f\u202e\u2028\u2066\ttab\nnext"
CONTROL_CODES = (*range(32), *range(127, 160), *range(0x2028, 0x202F), *range(0x2066, 0x206A))
CONTROLS = set(map(chr, CONTROL_CODES)) - {"\n", "\t"}  # which a terminal obeys


def spoiled(value: Any) -> Any:
    """Returns JSON with control sequences before every text in it."""
    if isinstance(value, str):
        return EVIL + value
    if isinstance(value, list):
        return [spoiled(x) for x in value]
    if isinstance(value, dict):
        # but not before a cursor: a list of many pages has to end
        return {key: x if key == "next" else spoiled(x) for key, x in value.items()}
    return value


@contextmanager
def hostile(port: int) -> Iterator[str]:
    """Yields the address of a proxy to the server on this port, which spoils its JSON."""

    class SpoilingHandler(BaseHTTPRequestHandler):
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
            response = connection.getresponse()
            content = response.read()
            connection.close()
            if "json" in response.headers.get("Content-Type", ""):
                content = json.dumps(spoiled(json.loads(content))).encode()
            self.send_response(response.status)
            self.send_header("Content-Type", response.headers.get("Content-Type", ""))
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_POST = do_PUT = do_GET  # noqa: N815  (names that http.server looks for)

        def log_message(self, *_: Any) -> None:
            return

    with ThreadingHTTPServer(("127.0.0.1", 0), SpoilingHandler) as server:
        serving = threading.Thread(target=server.serve_forever, args=(0.05,))
        serving.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            serving.join()
