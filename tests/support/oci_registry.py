"""An OCI registry in memory: the part of the distribution specification that a push and a pull use,
and nothing else. Every blob and manifest is held against the digest that it is sent by."""

import hashlib
import re
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import parse_qs, urlsplit
from uuid import uuid4


def digest_of(data):
    """Returns a digest as registries write it."""
    return f"sha256:{hashlib.sha256(data).hexdigest()}"


class Registry(ThreadingHTTPServer):
    """Holds blobs by digest, manifests `(type, bytes)` by digest and by repository and tag, and
    what it was asked for. `refuses` is what it answers to everything, with a status."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.blobs, self.uploads, self.manifests, self.asked = {}, {}, {}, []
        self.refuses = None

    @property
    def host(self):
        """Where it is."""
        return f"127.0.0.1:{self.server_address[1]}"


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        self._answered(self._read)

    def do_HEAD(self):
        self._answered(self._read)

    def do_POST(self):
        self._answered(self._begin)

    def do_PATCH(self):
        self._answered(self._append)

    def do_PUT(self):
        self._answered(self._finish)

    def log_message(self, *_):
        """Nothing is printed."""

    def _answered(self, answer):
        self.server.asked.append((self.command, self.path))
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        if self.server.refuses:
            self._send(*self.server.refuses)
        else:
            answer(body)

    def _read(self, _):
        name = self.path.rpartition("/")[2]
        if "/blobs/" in self.path and name in self.server.blobs:
            return self._send(200, self.server.blobs[name])
        if "/manifests/" in self.path and self._key(name) in self.server.manifests:
            kind, data = self.server.manifests[self._key(name)]
            return self._send(200, data, {"Content-Type": kind})
        return self._send(404, b'{"errors": [{"code": "MANIFEST_UNKNOWN"}]}')

    def _begin(self, _):
        upload = uuid4().hex
        self.server.uploads[upload] = b""
        self._send(202, b"", {"Location": f"{self.path}{upload}"})

    def _append(self, body):
        self.server.uploads[self.path.rpartition("/")[2]] += body
        self._send(202, b"", {"Location": self.path})

    def _finish(self, body):
        parts = urlsplit(self.path)
        name = parts.path.rpartition("/")[2]
        if "/manifests/" in self.path:
            if name.startswith("sha256:") and name != digest_of(body):
                return self._send(400, b'{"errors": [{"code": "DIGEST_INVALID"}]}')
            kept = self.headers["Content-Type"], body
            self.server.manifests[self._key(name)] = kept
            self.server.manifests[self._key(digest_of(body))] = kept
            return self._send(201, b"")
        data, (named,) = self.server.uploads.pop(name) + body, parse_qs(parts.query)["digest"]
        if named != digest_of(data):
            return self._send(400, b'{"errors": [{"code": "DIGEST_INVALID"}]}')
        self.server.blobs[named] = data
        return self._send(201, b"")

    def _key(self, name):
        repository = re.fullmatch(r"/v2/(.+)/(?:manifests|blobs)/[^/]+", urlsplit(self.path).path)
        return repository[1], name

    def _send(self, status, body, headers=()):
        self.send_response(status)
        for name, value in dict(headers).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


@contextmanager
def oci_registry():
    """Yields a registry while it runs."""
    registry = Registry()
    thread = Thread(target=registry.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield registry
    finally:
        registry.shutdown()
        registry.server_close()
        thread.join()
