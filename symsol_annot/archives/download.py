"""A download that can be resumed: a hidden folder with what has arrived, and a note that says of what.

The bytes are appended to where the host says that the file is still the one that was begun (If-Range, with its ETag or
its time of change), or where its digest is known, which is compared at the end. Else the download begins anew.
"""

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from http.client import HTTPResponse
from io import RawIOBase
from pathlib import Path

from symsol_annot.archives.hosts import NOT_THAT_RANGE, PARTIAL, READING_ERRORS, in_a_line, opened_url, unreachable
from symsol_annot.errors import DataError, DownloadError, OutputError, output_errors
from symsol_annot.system.files import write_atomically
from symsol_annot.system.reading import read_text
from symsol_annot.system.scratch import sweep

_DATA_NAME, _NOTE_NAME = "archive.part", "download.json"
_MADE_BY = "symsol-annot fetch"
_MOST_BYTES = 2**40  # of an archive, from a host that does not say how long it is
_NOTE_BYTES = 2**16
_BLOCK_BYTES = 2**18
_RANGE = re.compile(r"bytes (\d{1,15})-\d{1,15}/(\d{1,15})", re.ASCII)
_STRONG_ETAG = re.compile(r'"[!#-~]{1,200}"')
_DATE = re.compile(r"[A-Za-z0-9,: +-]{1,60}")
_NEW_FILE = os.O_CREAT | os.O_WRONLY | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


@dataclass(frozen=True)
class _Note:
    """What is known of the file that is being downloaded.

    Attributes:
        url: where it is from.
        validator: its ETag, or its time of change, as a request repeats it; None where the host gave neither.
        total: how many bytes it has; None where the host did not say.
    """

    url: str
    validator: str | None = None
    total: int | None = None


def download_folder(out: Path, url: str, file_name: str) -> Path:
    """Return the hidden folder in `out` that a download from this address has for itself."""
    return out / f".{file_name}.{hashlib.sha256(url.encode()).hexdigest()[:12]}.download"


class Download:
    """A download into a folder that holds nothing else; whoever opens it holds the folder's lock."""

    def __init__(self, url: str, folder: Path) -> None:
        """Find what an earlier run left.

        Raises:
            OutputError: the folder holds something that is no download from this address; nothing was touched.
        """
        self._url, self._folder = url, folder
        self.path = folder / _DATA_NAME
        with output_errors(folder):
            sweep(folder)
            there = {path.name for path in folder.iterdir()}
            note = _read_note(folder / _NOTE_NAME)
            is_ours = not there or (note is not None and note.url == url and there <= {_DATA_NAME, _NOTE_NAME})
            if not is_ours or self.path.is_symlink():
                raise OutputError(
                    f"{folder}: holds something that is no download of this command; nothing was touched. Move it "
                    "elsewhere, or choose another folder with --out"
                )
        self._note = note or _Note(url)

    def run(
        self, *, has_digest: bool, on_begin: Callable[[int | None, int], object], on_bytes: Callable[[int], object]
    ) -> Path:
        """Download what is missing, and return the path of the whole file.

        Args:
            has_digest: whether the file's digest is known and will be compared.
            on_begin: told how many bytes the file has, None where the host does not say, and how many are there.
            on_bytes: told how many more bytes have arrived.

        Raises:
            DownloadError: the host cannot be reached, or refuses, or the download broke off; what arrived is kept.
            OutputError: it cannot be written.
        """
        have = self._size()
        if have and have == self._note.total:
            on_begin(have, have)
            return self.path
        headers = {}
        if have and (self._note.validator or has_digest):
            headers["Range"] = f"bytes={have}-"
            if self._note.validator:
                headers["If-Range"] = self._note.validator
        try:
            with opened_url(self._url, headers) as response:
                if self._receive(response, have if headers else 0, on_begin, on_bytes):
                    return self.path
        except DownloadError as error:
            if error.status != NOT_THAT_RANGE or not headers:
                raise
        with opened_url(self._url) as response:  # the file has another length than was said before
            self._receive(response, 0, on_begin, on_bytes)
        return self.path

    def discard(self) -> None:
        """Remove the download: it was put in place, or is worth nothing."""
        with output_errors(self._folder):
            self.path.unlink(missing_ok=True)
            (self._folder / _NOTE_NAME).unlink(missing_ok=True)
            self._folder.rmdir()

    def _size(self) -> int:
        with output_errors(self.path):
            return self.path.stat().st_size if self.path.exists() else 0

    def _receive(
        self,
        response: HTTPResponse,
        asked_from: int,
        on_begin: Callable[[int | None, int], object],
        on_bytes: Callable[[int], object],
    ) -> bool:
        """Write what a host sends; False where it is a part of the file that does not fit what is there."""
        total: int | None
        if response.status == PARTIAL:
            part = _RANGE.fullmatch(response.headers.get("Content-Range", ""))
            if not part or int(part[1]) != asked_from or self._note.total not in (None, int(part[2])):
                return False
            have, total = asked_from, int(part[2])
            self._refuse_too_little_room(total - have, total)
        else:
            have, total = 0, _length(response)
            self._refuse_too_little_room(max((total or 0) - self._size(), 0), total or 0)
            self._begin_anew(_Note(self._url, _validator(response), total))
        on_begin(total, have)
        descriptor = -1
        with output_errors(self.path):
            descriptor = os.open(self.path, _NEW_FILE, 0o666)
        with os.fdopen(descriptor, "wb", buffering=0) as file:
            while block := self._next_block(response, have, total):
                self._write(file, block)
                have += len(block)
                on_bytes(len(block))
                if have > (total or _MOST_BYTES):
                    raise DataError(f"{self._url}: is longer than the {total or _MOST_BYTES:,} bytes that it may have")
            with output_errors(self.path):
                os.fsync(file.fileno())
        if total is not None and have < total:
            raise self._broken_off(have, total, "the host closed the connection")
        return True

    def _begin_anew(self, note: _Note) -> None:
        with output_errors(self._folder):
            self.path.unlink(missing_ok=True)  # before the note, which would be about other bytes
            write_atomically(self._folder / _NOTE_NAME, json.dumps({"made_by": _MADE_BY, **asdict(note)}).encode())
        self._note = note

    def _write(self, file: RawIOBase, block: bytes) -> None:
        with output_errors(self.path):
            rest = memoryview(block)
            while rest:
                rest = rest[file.write(rest) or 0 :]

    def _refuse_too_little_room(self, missing: int, total: int) -> None:
        """Refuse a file for which, with the set that is unpacked from it, the disk has no room."""
        with output_errors(self._folder):
            disk = shutil.disk_usage(self._folder)
        if disk.total > 0 and disk.free < missing + total:
            raise OutputError(
                f"{self._folder.parent}: has no room: {(missing + total) / 1e6:,.1f} MB are needed, for the archive "
                f"and what is unpacked from it, and {disk.free / 1e6:,.1f} MB are free; make room, then run the same "
                "command again"
            )

    def _next_block(self, response: HTTPResponse, have: int, total: int | None) -> bytes:
        try:
            return response.read1(_BLOCK_BYTES)
        except READING_ERRORS as error:
            raise self._broken_off(have, total, in_a_line(error)) from None

    def _broken_off(self, have: int, total: int | None, reason: str) -> DownloadError:
        if not have:
            return unreachable(self._url, reason)
        of_all = "" if total is None else f" of {total / 1e6:,.1f}"
        return DownloadError(
            f"{self._url}: the download broke off after {have / 1e6:,.1f}{of_all} MB: {reason}; what has arrived is "
            "kept: the same command resumes it"
        )


def _read_note(path: Path) -> _Note | None:
    """Return a download's note, or None where there is none, or one that this program did not write."""
    try:
        fields = json.loads(read_text(path, _NOTE_BYTES)) if not path.is_symlink() else None
    except (FileNotFoundError, ValueError, RecursionError):
        return None
    if not isinstance(fields, dict) or fields.pop("made_by", None) != _MADE_BY or set(fields) != set(asdict(_Note(""))):
        return None
    note = _Note(**fields)
    return note if isinstance(note.validator, str | None) and isinstance(note.total, int | None) else None


def _length(response: HTTPResponse) -> int | None:
    stated = response.headers.get("Content-Length", "")
    return int(stated) if re.fullmatch(r"\d{1,15}", stated, re.ASCII) else None


def _validator(response: HTTPResponse) -> str | None:
    """Return what tells a later request whether the file is still the same: a strong ETag, or its time of change."""
    etag: str = response.headers.get("ETag", "")
    changed: str | None = response.headers.get("Last-Modified")
    if _STRONG_ETAG.fullmatch(etag):
        return etag
    return changed if changed and _DATE.fullmatch(changed) else None
