"""Fetching a set: its archive from a path or an address, compared with its digest, unpacked, and put in place whole."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from urllib.parse import unquote, urlsplit, urlunsplit
from urllib.request import url2pathname

from symsol_annot.archives.archive import ARCHIVE_ENDING, archive_sha256, is_set_name, read_archive
from symsol_annot.archives.digest_files import DIGEST_ENDING, MAX_DIGEST_BYTES, checked_digest, digest_in
from symsol_annot.archives.download import Download, download_folder
from symsol_annot.archives.hosts import read_url
from symsol_annot.errors import DataError, DownloadError, OutputError, SettingsError, output_errors
from symsol_annot.sets.manifest import Manifest, read_manifest
from symsol_annot.system.files import new_folder
from symsol_annot.system.locks import held_folder
from symsol_annot.system.reading import file_sha256, open_regular, read_bytes

_HOSTED = ("http", "https")
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):(?://|(?<=file:)/)")  # one letter is a Windows drive's
_FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,150}")
_NOT_FOUND, _SERVER_ERROR = 400, 500

OnBegin: TypeAlias = Callable[[int | None, int], object]  # told a length in bytes, if it is known, and what is done
OnBytes: TypeAlias = Callable[[int], object]  # told how many more bytes are done


@dataclass(frozen=True)
class FetchedSet:
    """A set that was put in place, or was there already.

    Attributes:
        folder: of the set.
        manifest: of the set.
        sha256: of the archive, as it was found to be; None where no digest was given or lay beside it.
        was_there: whether the folder held the set already, whole, so that nothing was written.
    """

    folder: Path
    manifest: Manifest
    sha256: str | None
    was_there: bool = False


@dataclass(frozen=True)
class _Source:
    """Where an archive is: `url` of http or https, or else `path`."""

    text: str
    file_name: str
    url: str | None = None
    path: Path = Path()


@dataclass(frozen=True)
class _Digest:
    sha256: str
    stated_by: str


def fetch(
    source: str,
    out: Path,
    sha256: str | None = None,
    on_begin: OnBegin = lambda *_: None,
    on_bytes: OnBytes = lambda _: None,
) -> FetchedSet:
    """Put the set of an archive into a folder of sets, where it appears once it is whole.

    A download that broke off is resumed by the same call. Nothing that is there is written over.

    Args:
        source: of the archive: a path, or an address that begins with file://, http:// or https://.
        out: the folder of sets; made where it is missing.
        sha256: the archive's digest; by default the one in the file beside it, NAME.tar.sha256, if there is one.
        on_begin: told of the archive's length before the first byte, and how much of it is there already.
        on_bytes: told how many more bytes have arrived or, from a path, are unpacked.

    Raises:
        SettingsError: the address is of an unknown kind, or the digest is none.
        DownloadError: the host refuses or cannot be reached, or the download broke off.
        DataError: the archive does not have the digest, is damaged, or is no archive of one finished set; or its place
            holds something else.
        OutputError: a file cannot be written.
    """
    found = _source_of(source)
    digest = _digest_of(found, sha256)
    there = _there_already(found, out, digest)
    if there is not None:
        return there
    with held_folder(download_folder(out, source, found.file_name)):
        if found.url is None:
            return _put_in_place(found.path, found.text, out, digest, on_begin, on_bytes)
        return _downloaded(found.url, found, out, digest, on_begin, on_bytes)


def _source_of(text: str) -> _Source:
    scheme = _SCHEME.match(text)
    if scheme is None:
        return _Source(text, _file_name(Path(text).name), path=Path(text))
    kind = scheme[1].lower()
    if kind not in (*_HOSTED, "file"):
        raise SettingsError(f"{text}: {kind}:// is not known: expected a path, file://, http:// or https://")
    try:
        parts = urlsplit(text)
        host = parts.hostname
    except ValueError as error:
        raise SettingsError(f"{text}: is no address: {error}") from None
    if kind == "file":
        if host not in (None, "localhost"):
            raise SettingsError(f"{text}: is on another machine: expected file:///path/on/this/machine")
        if "\0" in (path := url2pathname(parts.path)):
            raise SettingsError(f"{text}: is no address: a path has no null byte")
        return _Source(text, _file_name(Path(path).name), path=Path(path))
    if not host:
        raise SettingsError(f"{text}: names no host: expected an address like https://example.org/cylO.tar")
    if not (text.isascii() and text.isprintable() and " " not in text):
        raise SettingsError(f"{text}: is no address: expected ASCII without spaces; write others as % and two digits")
    return _Source(text, _file_name(unquote(parts.path).rpartition("/")[2]), url=text)


def _file_name(name: str) -> str:
    return name if _FILE_NAME.fullmatch(name) else f"archive{ARCHIVE_ENDING}"


def _digest_of(source: _Source, given: str | None) -> _Digest | None:
    """Return the archive's digest: the one given, else the one beside it; None where there is neither.

    Raises:
        DataError: the file beside it is no such file, or states another digest than the one given.
    """
    asked = None if given is None else _Digest(checked_digest(given), "--sha256")
    what, data = _file_beside(source)
    if data is None:
        return asked
    try:
        stated = _Digest(digest_in(data, source.file_name, what), what)
    except DataError:
        if asked is None:
            raise
        return asked
    if asked is not None and asked.sha256 != stated.sha256:
        raise DataError(
            f"{source.text}: --sha256 is {asked.sha256}, and {what} states {stated.sha256}; nothing was fetched. One "
            "of the two is of another archive, or mistyped"
        )
    return asked or stated


def _file_beside(source: _Source) -> tuple[str, bytes | None]:
    """Return the name and the bytes of the file with the digest; None where it is not there."""
    if source.url is None:
        path = source.path.parent / (source.path.name + DIGEST_ENDING)
        try:
            return str(path), read_bytes(path, MAX_DIGEST_BYTES)
        except FileNotFoundError:
            return str(path), None
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    parts = urlsplit(source.url)
    url = urlunsplit(parts._replace(path=parts.path + DIGEST_ENDING))
    try:
        return url, read_url(url, MAX_DIGEST_BYTES)
    except DownloadError as error:
        if error.status is None or not _NOT_FOUND <= error.status < _SERVER_ERROR:
            raise
        return url, None


def _there_already(source: _Source, out: Path, digest: _Digest | None) -> FetchedSet | None:
    """Return the set that lies where the archive's name says that it belongs, if it is whole and the archive's.

    Raises:
        OutputError: something else lies there.
    """
    name = source.file_name.removesuffix(ARCHIVE_ENDING)
    folder = out / name
    if digest is None or not is_set_name(name) or not _is_taken(folder):
        return None
    try:
        if archive_sha256(folder, name) == digest.sha256:
            return FetchedSet(folder, read_manifest(folder), digest.sha256, was_there=True)
    except (DataError, OSError):  # no set, or one without its shards
        pass
    raise _taken(folder)


def _is_taken(folder: Path) -> bool:
    with output_errors(folder):
        return os.path.lexists(folder) and not (folder.is_dir() and not any(folder.iterdir()))


def _taken(folder: Path) -> OutputError:
    return OutputError(
        f"{folder}: is there already, and is not the set of this archive, or that set damaged; nothing was touched. "
        "Move it elsewhere, or choose another folder with --out"
    )


def _downloaded(
    url: str, source: _Source, out: Path, digest: _Digest | None, on_begin: OnBegin, on_bytes: OnBytes
) -> FetchedSet:
    folder = download_folder(out, url, source.file_name)
    download = Download(url, folder)
    path = download.run(has_digest=digest is not None, on_begin=on_begin, on_bytes=on_bytes)
    try:
        fetched = _put_in_place(path, url, out, digest, lambda *_: None, lambda _: None)
    except DataError:  # of the archive: to keep it would be to fail with it for good
        download.discard()
        raise
    download.discard()
    return fetched


def _put_in_place(
    path: Path, what: str, out: Path, digest: _Digest | None, on_begin: OnBegin, on_bytes: OnBytes
) -> FetchedSet:
    """Compare an archive with its digest, and unpack it beside its place until it is whole."""
    try:
        _refuse_other_digest(path, what, digest)
        descriptor = open_regular(path)
    except IsADirectoryError:
        raise DataError(
            f"{what}: is a folder, and an archive is a file like cylO.tar; a set in a folder is in place as it is"
        ) from None
    except OSError as error:
        raise DataError(f"{what}: cannot be read: {error.strerror}") from None
    with os.fdopen(descriptor, "rb") as file:
        archived = read_archive(file, what)
        folder, sha256 = out / archived.name, digest.sha256 if digest else None
        if _is_taken(folder):
            if archived.is_in(folder):
                return FetchedSet(folder, archived.manifest, sha256, was_there=True)
            raise _taken(folder)
        on_begin(sum(entry.bytes or 0 for entry in archived.manifest.shards), 0)
        with new_folder(folder) as new:
            archived.unpack(file, what, new, on_bytes)
    return FetchedSet(folder, archived.manifest, sha256)


def _refuse_other_digest(path: Path, what: str, digest: _Digest | None) -> None:
    if digest is None:
        return
    found = file_sha256(path)
    if found != digest.sha256:
        raise DataError(
            f"{what}: is damaged, or another archive: expected SHA-256 {digest.sha256} ({digest.stated_by}), found "
            f"{found}; nothing was put in place. Fetch it again, or look whether the digest is right"
        )
