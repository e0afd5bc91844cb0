"""Zips in the layout of the original SYMSOL, damaged inside and out, imported."""

import contextlib
import io
import struct
import zipfile
import zlib

import fuzz_predictions

from attack import laws
from attack.commands import run_command
from attack.damage import numbers_at
from attack.kinds import Attempt, Kind
from attack.signing import read_document

_NAMES = (
    "../../outside/made",
    "/symsol-annot-attack",
    "test/images/tet_99999.png",
    "test/images/../../x.png",
    "test/rotations.npz",
    "test/images/tet_00000.png",
    "\x1b[2J",
    "x" * 3000,
    "a\\..\\..\\b",
    "nul\0l",
    "folder/",
)


def make_zip(folder):
    """Make a zip of two objects."""
    folder.mkdir()
    import symsol_source

    files, _ = symsol_source.content(("tet", "tetX"), counts={"train": 2, "test": 3})
    symsol_source.write_zip(folder / "symsol.zip", files)


class Zips(Kind):
    """Bytes of a zip, its members, the arrays and the pictures in it."""

    name, cases = "zips", 1000
    modules, bases = ("symsol.importing", "sets.dataset", "cli"), ("zips",)

    def __init__(self, root):
        self._content = (root / "zips" / "symsol.zip").read_bytes()
        with zipfile.ZipFile(io.BytesIO(self._content)) as file:
            self._files = {name: file.read(name) for name in file.namelist()}

    def attempt(self, place, number, rng):
        path, kind = place.case / "symsol.zip", rng.random()
        if kind < 0.35:
            content, done = _damaged_bytes(self._content, rng)
            path.write_bytes(content)
        else:
            files = [[name, data, {}] for name, data in self._files.items()]
            change = CHANGES[rng.integers(len(CHANGES))]
            done = [change.__name__]
            with contextlib.suppress(ValueError):
                change(files, rng)
            _write(path, files)
        return Attempt(done, lambda: import_and_hold(path, place.out, by_command=kind * 10 % 1 < 0.4))


def import_and_hold(path, out, *, by_command):
    """Import a zip; each set that is made must obey the laws."""
    from symsol_annot import load
    from symsol_annot.symsol.importing import import_symsol

    if by_command:
        outcome = "right" if run_command("import-symsol", path, "--out", out, "--workers", 1) == 0 else "refused"
    else:
        made = list(import_symsol(path, out, (), workers=1))
        outcome = "right" if made else "refused"
    for manifest in sorted(out.glob("*/manifest.json")):
        if not read_document(manifest.parent)["fingerprint"]:
            raise laws.SilentError("a set that is not finished")
        with load(manifest.parent) as dataset:
            if dataset.is_annotated:
                laws.check_labels(dataset.labels(), has_marking=False)
            for sample in dataset:
                laws.check_sample(sample, dataset.image_size, len(dataset.parts))
    return outcome


def _damaged_bytes(content, rng):
    """Return a zip with damaged bytes, those of its headers as likely as all others."""
    content = bytearray(content)
    if rng.random() < 0.5:
        signature = (b"PK\1\2", b"PK\3\4", b"PK\5\6")[rng.integers(3)]
        places = [at for at in range(len(content)) if content[at : at + 4] == signature]
        at, size = places[rng.integers(len(places))] + int(rng.integers(4, 46)), int(rng.choice([1, 2, 4]))
        content[at : at + size] = numbers_at(rng, size)
        return bytes(content), [f"{signature!r}: a number at {at}"]
    damage = fuzz_predictions.BYTES[rng.integers(len(fuzz_predictions.BYTES))]
    damage(content, rng)
    return bytes(content), [damage.__name__]


def _write(path, files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data, options in files:
            info = zipfile.ZipInfo(name)
            info.compress_type = options.get("method", zipfile.ZIP_DEFLATED)
            info.external_attr = options.get("mode", 0o644) << 16
            file.writestr(info, data)


def _any(files, rng, ending=""):
    found = [file for file in files if file[0].endswith(ending)]
    return found[rng.integers(len(found))]


def odd_name(files, rng):
    _any(files, rng)[0] = _NAMES[rng.integers(len(_NAMES))]


def extra_member(files, rng):
    files.append([_NAMES[rng.integers(len(_NAMES))], b"extra", {}])


def missing_member(files, rng):
    files.remove(_any(files, rng))


def link(files, rng):
    file = _any(files, rng)
    file[1], file[2] = b"../../../outside/canary.h5", {"mode": 0o120777}


def other_method(files, rng):
    _any(files, rng)[2] = {"method": (zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)[rng.integers(3)]}


def bomb(files, rng):
    """A member that inflates to as much as a gigabyte."""
    _any(files, rng)[1] = bytes(int(rng.choice([2**20, 2**26, 2**28])))


def many_members(files, rng):
    files.extend([f"test/images/tet_{i:05d}.png", b"", {}] for i in range(3, 3000))


def damaged_picture(files, rng):
    file = _any(files, rng, ".png")
    data = bytearray(file[1])
    at = int(rng.integers(len(data)))
    data[at] ^= 1 << int(rng.integers(8))
    file[1] = bytes(data)


def picture_of_another_size(files, rng):
    """IHDR says another size, or another kind of colour, with the right checksum."""
    file = _any(files, rng, ".png")
    data = bytearray(file[1])
    sides = [int(rng.choice([0, 1, 15, 17, 4096, 2**16, 2**31 - 1, 2**31])) for _ in range(2)]
    data[16:24] = struct.pack(">II", *sides)
    if rng.random() < 0.4:
        data[24:26] = bytes([int(rng.choice([1, 8, 16])), int(rng.choice([0, 2, 3, 4, 6, 9]))])
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    file[1] = bytes(data)


def picture_with_more(files, rng):
    """Text that inflates to much, an animation, an embedded profile."""
    file = _any(files, rng, ".png")
    kind = (b"zTXt", b"iTXt", b"iCCP", b"acTL", b"eXIf", b"tRNS", b"PLTE", b"IDAT")[rng.integers(8)]
    body = b"x\0\0" + zlib.compress(bytes(int(rng.choice([10, 2**26]))))
    chunk = struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    file[1] = file[1][:33] + chunk + file[1][33:]


def damaged_table(files, rng):
    """Damage to the arrays' own zip: bytes, or numbers of the npy header."""
    file = _any(files, rng, "rotations.npz")
    with zipfile.ZipFile(io.BytesIO(file[1])) as inner:
        members = {name: inner.read(name) for name in inner.namelist()}
    name = sorted(members)[rng.integers(len(members))]
    data = bytearray(members[name])
    end = len(data) if rng.random() < 0.3 else min(len(data), 128)
    at = int(rng.integers(end))
    data[at] = int(rng.integers(256))
    members[name] = bytes(data)
    if rng.random() < 0.2:
        members[_NAMES[rng.integers(len(_NAMES))].replace("\0", "")] = b""
    file[1] = _zipped(members)


def odd_header(files, rng):
    """An npy header that says something else."""
    file = _any(files, rng, "rotations.npz")
    headers = (
        "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999, 12, 3, 3), }",
        "{'descr': '<f4', 'fortran_order': True, 'shape': (3, 12, 3, 3), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (3, 12, 3, 3), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-3, 12, 3, 3), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 10000000000000000000000, 3, 3), }",
        "__import__('os').mkdir('/symsol-annot-attack')",
        "(" * 3000,
        "{" + " " * 60_000,
    )
    text = headers[rng.integers(len(headers))].encode() + b"\n"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(1000)
    file[1] = _zipped({"tet.npy": npy, "tetX.npy": npy})


def wrong_values(files, rng):
    """Rotations that are none."""
    file = _any(files, rng, "rotations.npz")
    with zipfile.ZipFile(io.BytesIO(file[1])) as inner:
        members = {name: bytearray(inner.read(name)) for name in inner.namelist()}
    data = members[sorted(members)[rng.integers(len(members))]]
    at = 128 + 4 * int(rng.integers((len(data) - 128) // 4))
    value = [float("nan"), float("inf"), 0.0, 2.0, -1.0, 1e-40][rng.integers(6)]
    data[at : at + 4] = struct.pack("<f", value)
    file[1] = _zipped({name: bytes(data) for name, data in members.items()})


def _zipped(members):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as file:
        for name, content in members.items():
            file.writestr(name, content)
    return data.getvalue()


CHANGES = (
    odd_name,
    extra_member,
    missing_member,
    link,
    other_method,
    bomb,
    many_members,
    damaged_picture,
    picture_of_another_size,
    picture_of_another_size,
    picture_with_more,
    damaged_table,
    damaged_table,
    odd_header,
    wrong_values,
)
