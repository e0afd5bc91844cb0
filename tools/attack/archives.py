"""Archives of sets, damaged inside and out, fetched from a path and from hosts."""

import bz2
import gzip
import hashlib
import io
import json
import lzma
import tarfile
from functools import partial

from attack import laws
from attack.commands import run_command
from attack.damage import damage_json, json_bytes, numbers_at
from attack.hosts import HOSTS, Host
from attack.kinds import Attempt, Kind
from attack.signing import read_document

_NAME = "tetX"
_BLOCK = 512
_TYPES = (tarfile.LNKTYPE, tarfile.SYMTYPE, tarfile.CHRTYPE, tarfile.BLKTYPE, tarfile.DIRTYPE, tarfile.FIFOTYPE)
_EXTENSIONS = (tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK, tarfile.GNUTYPE_SPARSE, tarfile.XHDTYPE)
_ODD_NAMES = (
    "../../outside/made",
    "../../outside/manifest.json",
    "/symsol-annot-attack",
    "tetX/../../outside/made",
    "tetX/../made",
    "./tetX/manifest.json",
    "tetX//manifest.json",
    "tetX\\..\\made",
    "tetX/sub/test-00000-of-00001.h5",
    "tetX/nul\0l",
    "tetX/\x1b[2J",
    "other/manifest.json",
    "tetX",
    "tetX/",
    "",
    ".",
    "..",
    "CON/manifest.json",
    "t" * 90 + "/manifest.json",
)


def make_archives(folder):
    """Make a set and its archive."""
    from made_sets import make_set

    from symsol_annot.archives.archive import archive_blocks

    made = make_set(folder / "sets", _NAME, train=5, test=20, size=16)
    (folder / f"{_NAME}.tar").write_bytes(b"".join(archive_blocks(made, _NAME)))


class Archives(Kind):
    """Members of an archive, its bytes, its digest, and the host that it is fetched from."""

    name, cases = "archives", 1000
    modules, bases = ("archives.fetching", "sets.dataset", "cli"), ("archives",)

    def __init__(self, root):
        self._folder = root / "archives" / "sets" / _NAME
        self._content = (root / "archives" / f"{_NAME}.tar").read_bytes()
        with tarfile.open(fileobj=io.BytesIO(self._content)) as archive:
            self._files = [(member.name, archive.extractfile(member).read()) for member in archive]

    def attempt(self, place, number, rng):
        content, done = self._content, []
        kind = rng.random()
        if kind < 0.4:
            members = [_member(name, data) for name, data in self._files]
            change = CHANGES[rng.integers(len(CHANGES))]
            change(members, rng)
            content, done = b"".join(map(b"".join, members)) + bytes(2 * _BLOCK), [change.__name__]
        elif kind < 0.7:
            change = BYTES[rng.integers(len(BYTES))]
            content, done = change(self._content, rng), [change.__name__]
        by_command = bool(rng.random() < 0.3)
        beside = _digest_beside(content, rng)
        if kind >= 0.6:
            answers = HOSTS[rng.integers(len(HOSTS))]
            done += [f"a host: {answers.__name__}"]
            seed = int(rng.integers(2**31))
            return Attempt(done, partial(self._from_host, place.out, content, beside, answers, seed, by_command))
        path = place.case / f"{_NAME}.tar"
        path.write_bytes(content)
        if beside is not None:
            path.with_name(f"{path.name}.sha256").write_bytes(beside)
        source = f"file://{path}" if rng.random() < 0.2 else str(path)
        return Attempt(done, lambda: self._fetched(source, place.out, by_command=by_command))

    def _from_host(self, out, content, beside, answers, seed, by_command):
        with Host(content, beside, answers, seed) as host:
            for _ in range(2):  # what broke off is resumed
                outcome = self._refusable(f"http://127.0.0.1:{host.port}/{_NAME}.tar", out, by_command=by_command)
                if outcome == "right":
                    break
        return outcome

    def _refusable(self, source, out, *, by_command):
        from symsol_annot.errors import SymsolError

        try:
            return self._fetched(source, out, by_command=by_command)
        except SymsolError as error:
            if any(not line.isprintable() for line in str(error).split("\n")):
                raise
            self._hold(out, is_right=False)
            return "refused"

    def _fetched(self, source, out, *, by_command):
        from symsol_annot.archives.fetching import fetch

        is_right = True
        if by_command:
            is_right = run_command("fetch", source, "--out", out) == 0
        else:
            fetch(source, out)
        self._hold(out, is_right=is_right)
        return "right" if is_right else "refused"

    def _hold(self, out, *, is_right):
        """Raise a SilentError where the folder holds anything else than the set, or a set that was refused."""
        shown = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
        if shown != ([_NAME] if is_right else []):
            raise laws.SilentError(f"the folder of sets holds {shown}")
        if not is_right:
            return
        if read_document(out / _NAME) != read_document(self._folder):
            raise laws.SilentError("another manifest was put in place")
        found = {path.name: path.read_bytes() for path in (out / _NAME).iterdir()}
        for path in self._folder.glob("*.h5"):
            if found.pop(path.name, None) != path.read_bytes():
                raise laws.SilentError(f"{path.name} was put in place with other bytes")
        if set(found) != {"manifest.json"}:
            raise laws.SilentError(f"more than the set was put in place: {sorted(found)}")


def _digest_beside(content, rng):
    """Return the file that lies beside an archive: its own digest, that of another, none, or what is no digest."""
    kind = rng.random()
    if kind < 0.4:
        return None
    if kind < 0.7:
        return f"{hashlib.sha256(content).hexdigest()}  {_NAME}.tar\n".encode()
    odd = (b"", b"\xff" * 100, b"0" * 64, b"0" * 64 + b"  tetX.tar\n", b"\x1b[2J" * 20, b"x" * 70_000, b"<html>\n" * 90)
    return odd[rng.integers(len(odd))]


# Members: each a list of a header and the padded bytes behind it


def _header(name, size, kind=tarfile.REGTYPE, linkname="", **fields):
    info = tarfile.TarInfo(name)
    info.size, info.type, info.linkname = size, kind, linkname
    for field, value in fields.items():
        setattr(info, field, value)
    return info.tobuf(tarfile.GNU_FORMAT, errors="surrogateescape")


def _member(name, data, **fields):
    return [_header(name, len(data), **fields), data + bytes(-len(data) % _BLOCK)]


def _with_checksum(header):
    """Return a header with its checksum made right again."""
    blank = header[:148] + b" " * 8 + header[156:]
    return header[:148] + b"%06o\0 " % (sum(blank[:_BLOCK]) % 8**6) + header[156:]


def _any(members, rng):
    return int(rng.integers(len(members)))


def _name_of(member):
    return member[0][:100].split(b"\0")[0].decode(errors="replace")


def odd_name(members, rng):
    at = _any(members, rng)
    members[at] = _member(_ODD_NAMES[rng.integers(len(_ODD_NAMES))], members[at][1])


def extra_member(members, rng):
    members.insert(_any(members, rng), _member(_ODD_NAMES[rng.integers(len(_ODD_NAMES))], b"extra" * 50))


def missing_member(members, rng):
    del members[_any(members, rng)]


def member_twice(members, rng):
    members.append(members[_any(members, rng)])


def another_order(members, rng):
    rng.shuffle(members)


def other_type(members, rng):
    """A member becomes a link out of the folder, a device, a pipe or a folder."""
    at = _any(members, rng)
    kind, to = _TYPES[rng.integers(len(_TYPES))], ("../../outside/canary.h5", "/dev/zero", "manifest.json")
    members[at] = [_header(_name_of(members[at]), 0, kind, to[rng.integers(len(to))], devmajor=1, devminor=5)]


def link_then_file(members, rng):
    """A link, and behind it a file that would be written through it."""
    members.insert(0, [_header(_NAME, 0, tarfile.SYMTYPE, "../../outside")])


def extension(members, rng):
    """A header that renames the next file, or says that it is sparse or longer."""
    kind = _EXTENSIONS[rng.integers(len(_EXTENSIONS))]
    texts = (
        b"../../outside/made\0",
        b"27 path=../../outside/made\n",
        b"20 size=99999999999\n",
        b"9" * 700,
        b"\xff" * 40,
    )
    data = texts[rng.integers(len(texts))]
    members.insert(_any(members, rng), _member("././@LongLink", data, kind=kind))


def other_size(members, rng):
    """A member that says another size, with the right checksum, in octal or in binary."""
    at = _any(members, rng)
    sizes = (
        b"00000000000\0",
        b"00000000001\0",
        b"77777777777\0",
        b"-0000000001\0",
        b"\x80" + b"\xff" * 11,
        b"\xff" * 12,
    )
    header = members[at][0]
    members[at][0] = _with_checksum(header[:124] + sizes[rng.integers(len(sizes))] + header[136:])


def other_field(members, rng):
    """Any bytes of a header, with the right checksum."""
    at, start = _any(members, rng), int(rng.integers(0, 500))
    header = bytearray(members[at][0])
    size = int(rng.choice([1, 2, 4, 8]))
    header[start : start + size] = numbers_at(rng, size)
    members[at][0] = _with_checksum(bytes(header[:_BLOCK]))


def other_manifest(members, rng):
    """The manifest, damaged; or JSON of another kind, or as much of it as can be."""
    at = next(k for k, member in enumerate(members) if _name_of(member).endswith("manifest.json"))
    document = json.loads(members[at][1].rstrip(b"\0"))
    if rng.random() < 0.2:
        data = (b"", b"[]", b"null", b"[" * 100_000, b'{"format_version": 99}', b" " * 2**26)[rng.integers(6)]
    else:
        damage_json(document, rng)
        data = json_bytes(document)
    members[at] = _member(f"{_NAME}/manifest.json", data)


def other_shard(members, rng):
    at = next(k for k, member in enumerate(members) if _name_of(member).endswith(".h5"))
    data = bytearray(members[at][1])
    data[rng.integers(len(data) // 2)] ^= 1 << int(rng.integers(8))
    members[at][1] = bytes(data)


def many_members(members, rng):
    members.extend(_member(f"{_NAME}/test-{k:05d}-of-99999.h5", b"") for k in range(3000))


# Bytes


def cut(content, rng):
    return content[: rng.integers(len(content))]


def extended(content, rng):
    return content + (bytes(2**20), b"\xff" * 5000, content)[rng.integers(3)]


def flipped(content, rng):
    data = bytearray(content)
    for at in rng.integers(0, len(data), rng.integers(1, 6)):
        data[at] ^= 1 << int(rng.integers(8))
    return bytes(data)


def packed(content, rng):
    return (gzip.compress, bz2.compress, lzma.compress)[rng.integers(3)](content)


def something_else(content, rng):
    odd = (
        b"",
        b"<html><body>Not found</body></html>",
        b"PK\3\4" + bytes(300),
        bytes(10_240),
        b"\x89HDF\r\n\x1a\n" * 80,
    )
    return odd[rng.integers(len(odd))]


CHANGES = (
    *(odd_name, odd_name, extra_member, extra_member, missing_member, member_twice, another_order, other_type),
    *(other_type, link_then_file, extension, extension, other_size, other_size, other_field, other_field, other_field),
    *(other_manifest, other_manifest, other_manifest, other_shard, many_members),
)
BYTES = (cut, cut, extended, flipped, flipped, packed, something_else)
