"""Files of hosts, over http and https, by the standard library alone; what goes wrong is one DownloadError."""

import contextlib
import urllib.request
from collections.abc import Iterator, Mapping
from http.client import HTTPException, HTTPResponse
from typing import IO, Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit

from symsol_annot import __version__
from symsol_annot.errors import DownloadError

NOT_THAT_RANGE = 416
PARTIAL = 206
READING_ERRORS = (OSError, HTTPException, ValueError)  # of a connection that is lost, or speaks no http
_TIMEOUT_S = 60.0  # without a byte
_REFUSED = {
    401: "the host wants a permission that this command has not",
    403: "the host wants a permission that this command has not",
    404: "the host has no such file; look whether the address is right",
    410: "the host has no such file any more; look whether the address is right",
    429: "the host is asked too often; wait, then run the same command again",
}
_BUSY = "the host has trouble; run the same command again later"
_LOOP = "redirects in a loop, so it leads to no file; look whether the address is right"
_ERROR, _SERVER_ERROR = 400, 500


@contextlib.contextmanager
def opened_url(url: str, headers: Mapping[str, str] | None = None) -> Iterator[HTTPResponse]:
    """Open a file of a host.

    Args:
        url: of http or https; redirects to these are followed, but none from https to http.
        headers: of the request, besides the usual ones.

    Raises:
        DownloadError: the host cannot be reached, or refuses; `status` has the number of its answer.
    """
    own = {"User-Agent": f"symsol-annot/{__version__}", "Accept-Encoding": "identity"}
    request = urllib.request.Request(url, headers={**own, **(headers or {})})  # noqa: S310 - http and https alone
    try:
        response = _opener().open(request, timeout=_TIMEOUT_S)
    except HTTPError as error:
        error.close()
        raise DownloadError(f"{url}: {_refusal(error)}", status=error.code) from None
    except URLError as error:
        raise unreachable(url, error.reason) from None
    except READING_ERRORS as error:  # ValueError: an address that is none
        raise unreachable(url, error) from None
    with response:
        yield response


def read_url(url: str, limit: int) -> bytes:
    """Return the first bytes of a small file of a host, at most `limit`.

    Raises:
        DownloadError: as `opened_url`, or the connection was lost.
    """
    with opened_url(url) as response:
        try:
            return response.read(limit)
        except READING_ERRORS as error:
            raise unreachable(url, error) from None


def unreachable(url: str, reason: object) -> DownloadError:
    """Return the error of a host that does not answer."""
    return DownloadError(
        f"{url}: cannot be reached: {in_a_line(reason)}; look at the address and the network, then run "
        "the same command again"
    )


def in_a_line(reason: object) -> str:
    """Return what an error says, on one line."""
    return " ".join(str(reason).split()) or type(reason).__name__


def _opener() -> urllib.request.OpenerDirector:
    """Return what opens http and https and nothing else, through the proxies that the environment names."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler(),
        urllib.request.UnknownHandler(),
        urllib.request.HTTPHandler(),
        urllib.request.HTTPSHandler(),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPErrorProcessor(),
        _Redirects(),
    ):
        opener.add_handler(handler)
    return opener


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects, but none that gives up encryption."""

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        """Return the request that a redirect leads to."""
        if urlsplit(req.full_url).scheme == "https" and urlsplit(newurl).scheme != "https":
            raise DownloadError(f"{req.full_url}: redirects to {newurl}, which is not encrypted; nothing was fetched")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _refusal(error: HTTPError) -> str:
    if error.code < _ERROR and "infinite loop" in str(error.reason):
        return _LOOP
    reason = in_a_line(error.reason)
    advice = _REFUSED.get(error.code, _BUSY if error.code >= _SERVER_ERROR else "look whether the address is right")
    return f"HTTP {error.code} ({reason}): {advice}"
