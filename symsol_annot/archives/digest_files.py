"""The file with an archive's SHA-256 that lies beside it: a line of `sha256sum`, written and read side by side."""

import re

from symsol_annot.errors import DataError, SettingsError

DIGEST_ENDING = ".sha256"
MAX_DIGEST_BYTES = 2**16  # of such a file; one line has about a hundred
_LINE = re.compile(r"([0-9a-f]{64})(?: [ *](.+))?")
_DIGEST = re.compile(r"[0-9a-f]{64}")


def to_digest_line(sha256: str, archive_name: str) -> bytes:
    """Return the file of an archive's digest, as `sha256sum -c` reads it."""
    return f"{sha256}  {archive_name}\n".encode()


def digest_in(data: bytes, archive_name: str, what: str) -> str:
    """Return the digest that such a file states of an archive: its line, or the only one there is.

    Args:
        data: the file's bytes.
        archive_name: the archive's name.
        what: the file's own name, for messages.

    Raises:
        DataError: it is no such file.
    """
    lines = data.decode("utf-8", "replace").splitlines()
    found = [match for line in lines if (match := _LINE.fullmatch(line.strip().lower()))]
    named = [match for match in found if match[2] == archive_name.lower()]
    chosen = named or found
    if len(chosen) != 1 or (len(found) < len(lines) and not named):
        raise DataError(
            f"{what}: expected one line as sha256sum writes it, a digest and {archive_name}; give the digest with "
            "--sha256 instead"
        )
    return chosen[0][1]


def checked_digest(text: str) -> str:
    """Return a digest that a user gave, in lower case.

    Raises:
        SettingsError: it is no SHA-256.
    """
    if not _DIGEST.fullmatch(text.strip().lower()):
        raise SettingsError(f"--sha256: expected 64 hexadecimal digits, found {text!r}")
    return text.strip().lower()
