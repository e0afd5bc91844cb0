"""Zip files of unknown origin, read within limits: on their list of files, and on what a file unpacks to."""

import zipfile
from itertools import pairwise
from typing import IO, Any

_MAX_DIRECTORY_BYTES = 50_000_000  # of a zip; SYMSOL's 400,000 files take about 40 MB, a million names 1 GB of memory
_MAX_READ_BYTES = 2**28  # at once, of what is packed
_MAX_RATIO, _RATIO_SLACK = 20, 2**16  # unpacked to packed; rotations reach 4, PNG files 1, a bomb of zeros 1,000
_LOCAL_HEADER_BYTES = 30
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 1  # flag
_MAX_NAME = 100  # characters of a name that a message shows


class _Bounded:
    """A file for `zipfile`, which reads a zip's list of files at once, whatever size the zip says that it has."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.limit = _MAX_DIRECTORY_BYTES

    def read(self, size: int = -1) -> bytes:
        if size > self.limit:
            raise ValueError(f"its list of files has {size:,} bytes, more than the {self.limit:,} allowed")
        return self._file.read(self.limit if size < 0 else size)  # all is asked for of a zip's last 64 KiB alone

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def opened_zip(file: IO[bytes]) -> zipfile.ZipFile:
    """Open a zip, of whose list of files no more is read than is allowed.

    Raises:
        ValueError: the list is larger.
        zipfile.BadZipFile: it is no zip.
    """
    bounded: Any = _Bounded(file)
    opened = zipfile.ZipFile(bounded)
    bounded.limit = _MAX_READ_BYTES
    return opened


def member_faults(file: zipfile.ZipFile) -> list[str]:
    """List what a zip may not hold: names twice, encryption, odd packings, files that lie over each other."""
    members = file.infolist()
    if len(set(file.namelist())) < len(members):
        return ["holds files of the same name"]
    odd = [info for info in members if info.flag_bits & _ENCRYPTED or info.compress_type not in _METHODS]
    if odd:
        return [f"{_shown(odd[0])} is encrypted, or packed by another method than deflate"]
    ordered = sorted(members, key=lambda info: info.header_offset)
    for info, following in pairwise(ordered):
        if info.header_offset + _LOCAL_HEADER_BYTES + info.compress_size > following.header_offset:
            return [f"{_shown(info)} and {_shown(following)} lie over each other"]
    return []


def refuse_larger(info: zipfile.ZipInfo, limit: int) -> None:
    """Refuse a file that says it unpacks to more bytes than `limit`; none gives more than it says.

    Raises:
        ValueError: it does.
    """
    if info.file_size > limit:
        raise ValueError(f"is of {info.file_size} bytes, more than the {limit} allowed")


def refuse_ratio(info: zipfile.ZipInfo) -> None:
    """Refuse a file that says it unpacks to many more bytes than images and rotations can.

    Raises:
        ValueError: it does.
    """
    if info.file_size > _MAX_RATIO * info.compress_size + _RATIO_SLACK:
        raise ValueError(f"is of {info.file_size} bytes in {info.compress_size}, as only a bomb is packed")


def _shown(info: zipfile.ZipInfo) -> str:
    return f"{info.filename[:_MAX_NAME]!a}"
