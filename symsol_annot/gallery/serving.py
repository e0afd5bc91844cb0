"""Serving a gallery to the browser of this machine."""

import contextlib
import http.server
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from symsol_annot.errors import OutputError

HOST = "127.0.0.1"  # nobody else's browser reaches it


class _Handler(http.server.SimpleHTTPRequestHandler):
    """Gives the files of one folder, and says nothing."""

    def log_message(self, *_words: Any) -> None:
        """Keep the requests to itself."""

    def list_directory(self, _path: Any) -> None:
        """Give no list of a folder."""
        self.send_error(404, "no such page")


class _Server(http.server.ThreadingHTTPServer):
    """A server that a browser's broken connection does not make print."""

    def handle_error(self, _request: Any, _client: Any) -> None:
        """Forget the connection."""


@contextlib.contextmanager
def served(folder: Path, port: int = 0) -> Iterator[str]:
    """Serve a folder while the `with` block runs, and give the address of its index.html.

    Args:
        folder: of a gallery.
        port: on which to listen; 0 for any that is free.

    Raises:
        OutputError: another program listens on the port.
    """
    try:
        server = _Server((HOST, port), partial(_Handler, directory=str(folder)))
    except OSError as error:
        raise OutputError(
            f"port {port}: cannot be listened on: {error.strerror or error}; --port names another, 0 any that is free"
        ) from None
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}/index.html"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
