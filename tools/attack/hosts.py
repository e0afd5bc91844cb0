"""Hosts that break off, lie and lead astray, over plain sockets on this machine."""

import contextlib
import gzip
import socket
import socketserver
import threading

import numpy as np

_LOCATIONS = (
    "/tetX.tar",
    "//tetX.tar",
    "file:///etc/hostname",
    "ftp://127.0.0.1/x",
    "http://",
    "\t",
    "http://[::1",
    "?",
)


class Host:
    """A host on this machine, over plain sockets, so that it can say what no host should.

    Attributes:
        port: of it.
    """

    def __init__(self, content, beside, answers, seed):
        host = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self):
                host._handle(self.request)

        self._content, self._beside, self._answers, self._seed, self._asked = content, beside, answers, seed, 0
        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]

    def __enter__(self):
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._server.shutdown()
        self._server.server_close()

    def _handle(self, connection):
        request = b""
        with contextlib.suppress(OSError):
            connection.settimeout(5)
            while b"\r\n\r\n" not in request and len(request) < 2**16:
                if not (block := connection.recv(4096)):
                    return
                request += block
            self._asked += 1
            rng = np.random.default_rng([self._seed, self._asked])
            connection.sendall(self._answer(request.decode("latin-1"), rng))
            connection.shutdown(socket.SHUT_WR)

    def _answer(self, request, rng):
        path = request.split(" ")[1]
        if path.endswith(".sha256"):
            return http(b"" if self._beside is None else self._beside, "404 No" if self._beside is None else "200 OK")
        return self._answers(self._content, request, rng, self.port)


def http(body, status="200 OK", *headers, length=None):
    lines = [f"HTTP/1.1 {status}", f"Content-Length: {len(body) if length is None else length}", *headers]
    return "\r\n".join([*lines, "Connection: close", "", ""]).encode("latin-1") + body


def honest(content, request, rng, port):
    return http(content)


def breaks_off(content, request, rng, port):
    return http(content[: rng.integers(len(content) + 1)], length=len(content))


def breaks_off_and_resumes(content, request, rng, port):
    """Sends a part at a time, with a tag; ranges are right, or of another place."""
    _, found, span = request.lower().partition("range: bytes=")
    begin = int(span.split("-")[0]) if found else 0
    end = min(len(content), begin + 20_000)
    said = begin if rng.random() < 0.8 else begin + int(rng.integers(-3, 4))
    headers = ('ETag: "a"', f"Content-Range: bytes {said}-{len(content) - 1}/{len(content)}")
    return http(content[begin:end], "206 Part" if found else "200 OK", *headers, length=len(content) - begin)


def in_a_loop(content, request, rng, port):
    return http(b"", "302 Found", f"Location: http://127.0.0.1:{port}/{rng.integers(3)}")


def in_an_endless_chain(content, request, rng, port):
    return http(b"", "307 On", f"Location: /{rng.integers(2**40)}/tetX.tar")


def leads_astray(content, request, rng, port):
    return http(b"", "301 Moved", f"Location: {_LOCATIONS[rng.integers(len(_LOCATIONS))]}")


def wrong_length(content, request, rng, port):
    lengths = ("-1", "1", str(2**62), "9" * 400, "abc", "", "0x10", "1, 2", "١٢")
    return http(content, length=lengths[rng.integers(len(lengths))].encode().decode("latin-1"))


def wrong_range(content, request, rng, port):
    spans = ("bytes 0-1/2", "bytes */9", "bytes 5-1/99999999999999999999", "x", "", "bytes -1--1/-1")
    return http(content, "206 Part", f"Content-Range: {spans[rng.integers(len(spans))]}")


def wrong_status(content, request, rng, port):
    odd = (
        "999 X",
        "100 Continue",
        "204 None",
        "304 Same",
        "416 Range",
        "500 \x1b[2J",
        "200 " + "x" * 70_000,
        "abc",
        "",
    )
    return http(content, odd[rng.integers(len(odd))])


def many_headers(content, request, rng, port):
    return http(
        content, "200 OK", *(f"X-{k}: {'y' * int(rng.choice([1, 500]))}" for k in range(int(rng.choice([90, 3000]))))
    )


def encoded_transfer(content, request, rng, port):
    """Chunks of which some are none."""
    head = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
    chunks = (
        b"%x\r\n%s\r\n0\r\n\r\n" % (len(content), content),
        b"-5\r\n" + content,
        b"f" * 30 + b"\r\nx",
        b"zz\r\n",
        b"",
    )
    return head + chunks[rng.integers(len(chunks))]


def compressed(content, request, rng, port):
    return http(gzip.compress(content, 1), "200 OK", "Content-Encoding: gzip")


def nothing_of_http(content, request, rng, port):
    return (b"", b"\0" * 100, b"SSH-2.0-x\r\n", b"\x16\x03\x01\x02\x00", b"HTTP/9.9 200\r\n\r\n", b"HTTP/1.1\r\n" * 50)[
        rng.integers(6)
    ]


def says_what_a_terminal_obeys(content, request, rng, port):
    return http(b"\x1b[2J", "404 \x1b[2J\x1b]0;owned\x07", "Location: \x1b[31m")


HOSTS = (
    *(honest, honest, breaks_off, breaks_off, breaks_off_and_resumes, breaks_off_and_resumes, in_a_loop),
    *(in_an_endless_chain, leads_astray, wrong_length, wrong_range, wrong_status, many_headers, encoded_transfer),
    *(compressed, nothing_of_http, says_what_a_terminal_obeys),
)
