"""A host of files on this machine, over real http: with ranges or without, and connections that break off."""

import hashlib
import re
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

TAGS, DATES, NOTHING = "tags", "dates", "nothing"  # what the host says of whether a file is still the same


@dataclass
class Host:
    """What the host has, how it behaves, and what it was asked; all may be changed while it runs."""

    files: dict[str, bytes]
    redirects: dict[str, str] = field(default_factory=dict)
    statuses: dict[str, int] = field(default_factory=dict)
    has_ranges: bool = True
    has_lengths: bool = True
    validators: str = TAGS
    cut_after: int | None = None  # bytes of each answer, of files that are longer
    asked: list[tuple[str, str | None, int]] = field(default_factory=list)  # path, range, status
    sent: int = 0  # bytes of files

    def of(self, path):
        """The answers about a path, as range and status."""
        return [(span, status) for asked, span, status in self.asked if asked == path]

    def validator(self, path):
        tag = hashlib.sha256(self.files[path]).hexdigest()[:16]
        second = int(tag[:2], 16) % 60
        return {
            TAGS: ("ETag", f'"{tag}"'),
            DATES: ("Last-Modified", f"Mon, 05 Jan 2026 10:00:{second:02d} GMT"),
            NOTHING: ("X-None", ""),
        }[self.validators]

    def __enter__(self):
        host = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                host._answer(self)

            def log_message(self, *_):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02})
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        return self

    def __exit__(self, *_):
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _answer(self, request):
        path, span = request.path, request.headers.get("Range")
        if path in self.redirects:
            return self._say(request, 302, [("Location", self.redirects[path]), ("Content-Length", "0")])
        if path not in self.files or path in self.statuses:
            return self._say(request, self.statuses.get(path, 404), [("Content-Length", "0")])
        data, (name, value) = self.files[path], self.validator(path)
        begin = int(re.fullmatch(r"bytes=(\d+)-", span)[1]) if span and self.has_ranges else 0
        if request.headers.get("If-Range") not in (None, value):
            begin = 0
        if begin >= len(data) > 0:
            return self._say(request, 416, [("Content-Range", f"bytes */{len(data)}"), ("Content-Length", "0")])
        headers = [(name, value)] if value else []
        if self.has_lengths:
            headers.append(("Content-Length", str(len(data) - begin)))
        if begin:
            headers.append(("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}"))
        self._say(request, 206 if begin else 200, headers)
        part = data[begin:] if self.cut_after is None else data[begin : begin + self.cut_after]
        self.sent += len(part)
        request.wfile.write(part)
        request.close_connection = True
        return None

    def _say(self, request, status, headers):
        self.asked.append((request.path, request.headers.get("Range"), status))
        request.send_response(status)
        for name, value in headers:
            request.send_header(name, value)
        request.end_headers()
