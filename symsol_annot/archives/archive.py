"""A set's archive: an uncompressed tar file with the set's folder in it, written and read side by side.

Shards are compressed already. What is read is held to what a set consists of: one folder, in it a manifest and the
shards that it lists, of the sizes and with the SHA-256 that it states. `tarfile` parses single headers; the walk from
one to the next is done here, so that links, devices and extensions that rename files are never acted on.
"""

import hashlib
import os
import re
import tarfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from symsol_annot.errors import DataError, first_of
from symsol_annot.sets.manifest import (
    MANIFEST_NAME,
    MAX_MANIFEST_BYTES,
    Manifest,
    manifest_from_bytes,
    read_manifest,
)
from symsol_annot.system.reading import file_sha256, open_regular

ARCHIVE_ENDING = ".tar"
MAX_NAME = 100  # characters of a set's name: with a file's name behind it, it fits the header of a tar file
_SET_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_-]{{0,{MAX_NAME - 1}}}")
_COPY_BYTES = 2**20
_MAX_MEMBERS = 60_000  # a manifest of the largest size lists 50,000 shards
_LISTED_NAMES = 5
_SHOWN = 100  # characters of a name that a message shows
_PACK_AGAIN = "pack it again with `symsol-annot publish`, or with `tar --format=ustar -cf NAME.tar NAME`"


@dataclass(frozen=True)
class ArchivedSet:
    """What an archive holds, as its headers and its manifest say.

    Attributes:
        name: of the set's folder.
        manifest: of the set, finished.
        manifest_bytes: the same, as the file that it was read from.
        places: name of each shard to the offset of its bytes in the archive.
    """

    name: str
    manifest: Manifest
    manifest_bytes: bytes
    places: Mapping[str, int]

    def is_in(self, folder: Path) -> bool:
        """Tell whether a folder holds this set, whole: the manifest's bytes, and shards with the digests in it."""
        try:
            return all(file_sha256(folder / name) == sha256 for name, sha256 in self._digests().items())
        except OSError:
            return False

    def unpack(self, file: BinaryIO, what: str, folder: Path, on_bytes: Callable[[int], object]) -> None:
        """Write the set's files into an empty folder, each compared with its SHA-256 while it is written.

        Args:
            file: the archive.
            what: the archive's name, for messages.
            folder: an existing, empty folder.
            on_bytes: told how many more bytes are written.

        Raises:
            DataError: a shard does not have the SHA-256 that the manifest states.
            OSError: a file cannot be written.
        """
        _write_new(folder / MANIFEST_NAME, iter([self.manifest_bytes]))
        for entry in self.manifest.shards:
            file.seek(self.places[entry.file])
            found = _write_new(folder / entry.file, _counted(_blocks(file, int(entry.bytes or 0), what), on_bytes))
            if found != entry.sha256:
                raise DataError(
                    f"{what}: {self.name}/{entry.file}: is damaged: expected SHA-256 {entry.sha256}, found {found}; "
                    "nothing was put in place"
                )

    def _digests(self) -> dict[str, str | None]:
        own = hashlib.sha256(self.manifest_bytes).hexdigest()
        return {MANIFEST_NAME: own, **{entry.file: entry.sha256 for entry in self.manifest.shards}}


def is_set_name(name: str) -> bool:
    """Tell whether a set's folder of this name can be packed and unpacked."""
    return _SET_NAME.fullmatch(name) is not None


def archive_blocks(folder: Path, name: str) -> Iterator[bytes]:
    """Yield the bytes of a finished set's archive, which depend on the set's files and name alone.

    The files stand in the order of their names, so the manifest is the first; times and owners are 0.

    Args:
        folder: of the set.
        name: of its folder in the archive.

    Raises:
        DataError: the manifest is missing or damaged.
        OSError: a shard is missing or cannot be read.
    """
    manifest, length = read_manifest(folder), 0
    for file_name in sorted((MANIFEST_NAME, *(entry.file for entry in manifest.shards))):
        with os.fdopen(open_regular(folder / file_name), "rb") as file:
            header = tarfile.TarInfo(f"{name}/{file_name}")
            header.size = os.fstat(file.fileno()).st_size
            yield header.tobuf(tarfile.USTAR_FORMAT)
            yield from _blocks(file, header.size, str(folder / file_name))
        yield bytes(-header.size % tarfile.BLOCKSIZE)
        length += tarfile.BLOCKSIZE + _padded(header.size)
    length += 2 * tarfile.BLOCKSIZE  # two empty blocks are the end, filled up to a record
    yield bytes(2 * tarfile.BLOCKSIZE + -length % tarfile.RECORDSIZE)


def archive_sha256(folder: Path, name: str) -> str:
    """Return the SHA-256 of a set's archive without writing it.

    Raises:
        DataError, OSError: as `archive_blocks`.
    """
    digest = hashlib.sha256()
    for block in archive_blocks(folder, name):
        digest.update(block)
    return digest.hexdigest()


def read_archive(file: BinaryIO, what: str) -> ArchivedSet:
    """Read which set an archive holds; no shard is read.

    Args:
        file: the archive, which can be sought in.
        what: its name, for messages.

    Raises:
        DataError: it is no archive of one finished set, or is cut short.
    """
    members = _members(file, what)
    folders = {name.partition("/")[0] for name in members}
    if len(folders) != 1:
        found = f"has {first_of(sorted(folders), _LISTED_NAMES)}" if folders else "holds no files"
        raise DataError(f"{what}: {found}, where one set's folder belongs; {_PACK_AGAIN}")
    name = folders.pop()
    files = {inner.partition("/")[2]: member for inner, member in members.items()}
    if MANIFEST_NAME not in files:
        raise DataError(f"{what}: holds no {name}/{MANIFEST_NAME}, so it is no archive of a set; {_PACK_AGAIN}")
    data = _manifest_bytes(file, files.pop(MANIFEST_NAME), what)
    manifest = manifest_from_bytes(data, f"{what}: {name}/{MANIFEST_NAME}")
    _check_files(manifest, files, what)
    return ArchivedSet(name, manifest, data, {inner: member.offset for inner, member in files.items()})


@dataclass(frozen=True)
class _Member:
    offset: int
    size: int


def _members(file: BinaryIO, what: str) -> dict[str, _Member]:
    """Return name to place of an archive's files, which all lie in a folder; other kinds of entry are refused."""
    length, offset, members = file.seek(0, os.SEEK_END), 0, dict[str, _Member]()
    while True:
        file.seek(offset)
        block = file.read(tarfile.BLOCKSIZE)
        if not any(block) and len(block) == tarfile.BLOCKSIZE:
            return members
        header = _header(block, what, is_first=offset == 0)
        offset += tarfile.BLOCKSIZE
        if not 0 <= header.size <= length - offset:
            raise DataError(f"{what}: is cut short, or damaged: {_shown(header)} ends behind its end; fetch it again")
        if not _is_set_folder(header):
            _refuse_entry(header, what)
            if header.name in members:
                raise DataError(f"{what}: holds {_shown(header)} twice; {_PACK_AGAIN}")
            members[header.name] = _Member(offset, header.size)
            if len(members) > _MAX_MEMBERS:
                raise DataError(f"{what}: holds more than {_MAX_MEMBERS:,} files, which no set has")
        offset += _padded(header.size)


def _header(block: bytes, what: str, *, is_first: bool) -> tarfile.TarInfo:
    try:
        return tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
    except (tarfile.HeaderError, ValueError, IndexError) as error:
        if is_first:
            raise DataError(
                f"{what}: is no tar file ({error}); an archive of a set is what `symsol-annot publish` makes, like "
                "cylO.tar. An address that shows a page in a browser is not the file's own"
            ) from None
        raise DataError(f"{what}: is cut short, or damaged ({error}); fetch it again") from None


def _is_set_folder(header: tarfile.TarInfo) -> bool:
    """Tell whether an entry is the set's folder itself, which tar programs list and which says nothing."""
    return header.type == tarfile.DIRTYPE and header.size == 0 and is_set_name(header.name)


def _refuse_entry(header: tarfile.TarInfo, what: str) -> None:
    """Raise a DataError where an entry is no regular file in a folder of its own, as each file of a set is."""
    folder, _, file_name = header.name.partition("/")
    if header.name.startswith("/") or ".." in re.split(r"[/\\]", header.name):
        raise DataError(f"{what}: would write outside of the set's folder: {_shown(header)}; nothing was unpacked")
    if header.type not in (tarfile.REGTYPE, tarfile.AREGTYPE):
        kind = _KINDS.get(header.type, "an entry of an extension of tar")
        raise DataError(f"{what}: holds {kind}, where a set has regular files: {_shown(header)}; {_PACK_AGAIN}")
    if not is_set_name(folder) or not file_name or "/" in file_name:
        raise DataError(f"{what}: holds {_shown(header)}, which is no file of a set like cylO/{MANIFEST_NAME}")


_KINDS = {
    tarfile.LNKTYPE: "a link",
    tarfile.SYMTYPE: "a symbolic link",
    tarfile.CHRTYPE: "a device",
    tarfile.BLKTYPE: "a device",
    tarfile.FIFOTYPE: "a pipe",
    tarfile.DIRTYPE: "a folder",
}


def _manifest_bytes(file: BinaryIO, member: _Member, what: str) -> bytes:
    if member.size > MAX_MANIFEST_BYTES:
        raise DataError(
            f"{what}: its {MANIFEST_NAME} is larger than the {MAX_MANIFEST_BYTES:,} bytes that one may have"
        )
    file.seek(member.offset)
    return file.read(member.size)


def _check_files(manifest: Manifest, files: Mapping[str, _Member], what: str) -> None:
    """Raise a DataError where an archive's files are not those that the manifest lists, in name and size."""
    if not manifest.is_finished:
        raise DataError(f"{what}: holds a set that is not finished: its manifest lists shards without a digest")
    expected = {entry.file: entry.bytes for entry in manifest.shards}
    stray, missing = sorted(files.keys() - expected.keys()), sorted(expected.keys() - files.keys())
    if stray:
        names = first_of([ascii(name[:_SHOWN]) for name in stray], _LISTED_NAMES)
        raise DataError(f"{what}: holds files that are no part of its set: {names}; {_PACK_AGAIN}")
    if missing:
        raise DataError(f"{what}: lacks shards of its set: {first_of(missing, _LISTED_NAMES)}; {_PACK_AGAIN}")
    for name, member in files.items():
        if member.size != expected[name]:
            raise DataError(f"{what}: {name}: is damaged: expected {expected[name]} bytes, found {member.size}")


def _padded(size: int) -> int:
    return size + -size % tarfile.BLOCKSIZE


def _blocks(file: BinaryIO, size: int, what: str) -> Iterator[bytes]:
    """Yield so many bytes of a file, in blocks."""
    while size:
        block = file.read(min(size, _COPY_BYTES))
        if not block:
            raise DataError(f"{what}: became shorter while it was read; run the same command again")
        size -= len(block)
        yield block


def _counted(blocks: Iterator[bytes], on_bytes: Callable[[int], object]) -> Iterator[bytes]:
    for block in blocks:
        on_bytes(len(block))
        yield block


def _write_new(path: Path, blocks: Iterator[bytes]) -> str:
    """Write a file that must not be there yet, see to it that it reached the disk, and return its SHA-256."""
    digest = hashlib.sha256()
    with path.open("xb") as file:
        for block in blocks:
            digest.update(block)
            file.write(block)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest()


def _shown(header: tarfile.TarInfo) -> str:
    return ascii(header.name[:_SHOWN])
