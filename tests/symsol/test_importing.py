"""The original SYMSOL as sets of ours: what it says is kept, what it does not say stays unknown, no zip does harm.

Distances are taken here from chords, by scipy, not by the package's so3.
"""

import io
import json
import os
import pickle
import re
import shutil
import struct
import time
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import symsol_source
from made_sets import make_plan, make_set, threads
from PIL import Image
from scipy.spatial.distance import cdist
from symsol_source import COUNTS, npz, png, rotations, write_zip

import symsol_annot
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring import scoring
from symsol_annot.errors import (
    DataError,
    DifferentSetError,
    NotAnnotatedError,
    OutputError,
    SettingsError,
)
from symsol_annot.generation.generate import generate
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.verify import verify
from symsol_annot.symsol.importing import import_symsol
from symsol_annot.symsol.zip_reader import SymsolZip

NAMES = ("tet", "cone", "cyl", "tetX")
MEMBERS = {"tet": 12, "cone": 359, "cyl": 718}
SAME_RAD = 1e-6  # float32's entries are off by 6e-8


def angles(R, others):
    """(m, k) angles in rad from each of R to each of the others: 2 arcsin of half the chord, |R - R'| / (2 sqrt 2)."""
    chords = cdist(np.asarray(R, "f8").reshape(-1, 9), np.asarray(others, "f8").reshape(-1, 9))
    return 2 * np.arcsin(np.minimum(chords / 8**0.5, 1.0))


def everything(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def imported(path, out, *names, **options):
    return {made.folder.name: made for made in import_symsol(path, out, names, **options)}


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """A zip of four objects, what is in it, and the folder of its sets."""
    files, arrays = symsol_source.content(NAMES)
    folder = tmp_path_factory.mktemp("symsol")
    path = write_zip(folder / "symsol.zip", files)
    return path, arrays, imported(path, folder / "sets")


@pytest.mark.parametrize("name", NAMES)
def test_images_and_rotations_are_the_sources(source, name):
    _, arrays, made = source
    for split, count in COUNTS.items():
        samples = symsol_annot.load(made[name].folder, split)
        assert len(samples) == count
        for index, sample in enumerate(samples):
            assert np.array_equal(sample.image, arrays[name, split, "images"][index])
            assert angles(sample.rotation, arrays[name, split][index, 0]) < SAME_RAD
            assert np.abs(sample.rotation.T @ sample.rotation - np.eye(3)).max() < 1e-14  # float32 was not so near


@pytest.mark.parametrize("name", MEMBERS)
def test_sets_are_the_sources_lists_without_what_they_list_twice(source, name):
    _, arrays, made = source
    for split in COUNTS:
        for listed, sample in zip(arrays[name, split], symsol_annot.load(made[name].folder, split), strict=True):
            S = sample.symmetry_set
            assert len(S) == MEMBERS[name]
            distances = angles(listed, S)
            assert distances.min(axis=1).max() < SAME_RAD  # each listed one is in the set
            assert distances.min(axis=0).max() < SAME_RAD  # and nothing else is
            assert angles(S, S)[~np.eye(len(S), dtype=bool)].min() > 0.017  # 1.0028 degrees is 0.0175


def test_the_ends_of_circles_are_counted(source):
    _, _, made = source
    sources = {name: made[name].manifest.imported.source for name in NAMES}
    duplicates = {name: (source.rotations_listed, source.duplicates_removed) for name, source in sources.items()}
    assert duplicates == {"tet": (12, 0), "cone": (360, 1), "cyl": (720, 2), "tetX": (1, 0)}
    assert all(0 < made[name].off_so3 < SAME_RAD for name in NAMES)
    assert all(0 < made[name].off_sets_rad < SAME_RAD for name in MEMBERS)


def test_what_the_source_does_not_say_is_in_no_file(source):
    _, _, made = source
    manifest = json.loads((made["tetX"].folder / "manifest.json").read_text())
    assert manifest["source"]["convention"] == "unknown"
    unknown = {"object_sha256", "seed", "render", "tolerance_px"}
    assert {name for name, value in manifest.items() if value is None} == unknown
    assert manifest["camera"] == {"distance": None, "focal_px": None, "width": 16, "height": 16}
    with h5py.File(made["tetX"].folder / "test-00000-of-00001.h5") as file:
        assert set(file) == {"image", "rotation", "symmetry_group"}
        assert np.array_equal(file["symmetry_group"], np.eye(3)[None])
        names = {"format", "format_version", "object", "split", "first_index", "camera", "versions", "source"}
        assert set(file.attrs) == names
    with h5py.File(made["cyl"].folder / "test-00000-of-00001.h5") as file:
        assert set(file) == {"image", "rotation", "symmetry_group", "symmetry_mask"}


def test_of_a_marked_object_no_sets_are_known(source, here):
    _, _, made = source
    samples = symsol_annot.load(made["tetX"].folder)
    sample = samples[0]
    assert sample.symmetry_mask is sample.segmentation is sample.marking_visible is None
    assert np.isnan(sample.marking_pixels)
    with pytest.raises(NotAnnotatedError, match="none are known"):
        sample.symmetry_set  # noqa: B018
    with pytest.raises(NotAnnotatedError, match="none are known"):
        samples.labels()
    assert "without symmetry sets: none are known" in here("info", made["tetX"].folder).stdout


def test_imported_sets_are_valid_and_drawn_and_scored(source, here, tmp_path):
    _, _, made = source
    sets = made["tet"].folder.parent
    assert all(verify(made[name].folder) == [] for name in NAMES)
    assert here("verify", sets).stdout.count("whole and consistent") == len(NAMES)
    said = here("info", made["cyl"].folder)
    assert "convention unknown" in said.stdout
    assert "718 in 20" in said.stdout
    for name in ("tet", "tetX"):
        assert (
            here("plot", "images", made[name].folder, "--count", 2, "--out", tmp_path / f"{name}.png").returncode == 0
        )
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert picture.size[0] > 500
    samples = symsol_annot.load(made["tet"].folder)
    write_hypotheses(tmp_path / "preds.h5", samples, lambda index: samples[index].symmetry_set, method="truth")
    figures = scoring.score_file(tmp_path / "preds.h5", sets).tracks["hypotheses"].figures["all"]
    assert figures["recall_mean_error_rad"].value < SAME_RAD
    assert figures["coverage_at_5_deg"].value == 1.0


@pytest.mark.parametrize("option", ["--audit=2", "--repair"])
def test_an_imported_set_is_not_drawn_again(source, here, tmp_path, option):
    path, _, _ = source
    folder = imported(path, tmp_path, "tet")["tet"].folder
    if option == "--repair":
        (folder / "test-00000-of-00001.h5").unlink()
    done = here("verify", folder, option)
    assert done.returncode == 1
    assert "was imported" in done.stderr


def test_the_bytes_do_not_depend_on_the_threads(source, tmp_path):
    path, _, made = source
    again = imported(path, tmp_path, "tet", "tetX", workers=4)
    for name, there in again.items():
        assert everything(there.folder) == everything(made[name].folder)


def test_the_command_imports_and_leaves_what_is_there(source, here, tmp_path):
    path, _, _ = source
    done = here("import-symsol", path, "--out", tmp_path / "sets", "--object", "cone", "--object", "tetX")
    assert done.returncode == 0
    assert "sets of 359 rotations (360 listed, 1 of them twice)" in done.stdout
    assert "tetX: 20 train, 6 test images, no symmetry sets are known" in done.stdout
    before = {name: path.stat().st_mtime_ns for name, path in _files(tmp_path).items()}
    again = here("import-symsol", path, "--out", tmp_path / "sets", "--object", "cone")
    assert "was there already" in again.stdout
    assert {name: path.stat().st_mtime_ns for name, path in _files(tmp_path).items()} == before


def test_the_lines_of_the_symsol_page_run(source, here, tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "symsol.md").read_text()
    commands, code = (text for text in re.findall(r"```(?:python)?\n(.*?)```", page, flags=re.DOTALL))
    (tmp_path / "symsol_dataset.zip").symlink_to(source[0])
    monkeypatch.chdir(tmp_path)
    for command in commands.strip().splitlines():
        assert here(*command.split()[1:]).returncode == 0
    names = {}
    exec(code, names)
    assert len(names["sample"].symmetry_set) == 718


def _files(folder):
    return {str(path.relative_to(folder)): path for path in folder.rglob("*") if path.is_file()}


def test_symmetries_that_act_on_the_left_are_made_to_act_on_the_right(tmp_path):
    """A source whose matrices take camera to model lists g R; transposed, they are labels like ours."""
    files, arrays = symsol_source.content(("tet", "tetX"))
    for split in COUNTS:
        tables = {name: np.swapaxes(arrays[name, split], -1, -2) for name in ("tet", "tetX")}
        files[f"{split}/rotations.npz"] = npz({name: np.ascontiguousarray(table) for name, table in tables.items()})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    for name in ("tet", "tetX"):  # which lists nothing that would tell, but comes from the same source
        assert made[name].manifest.imported.source.transposed is True
        sample = symsol_annot.load(made[name].folder)[3]
        assert angles(sample.rotation, arrays[name, "test"][3, 0]) < SAME_RAD
    S = symsol_annot.load(made["tet"].folder)[3].symmetry_set
    assert angles(arrays["tet", "test"][3], S).min(axis=1).max() < SAME_RAD


def test_a_list_in_another_order_is_the_same_set(tmp_path):
    files, arrays = symsol_source.content(("cyl",))
    table = arrays["cyl", "train"]
    table[17, 1:] = table[17, 1:][np.random.default_rng(0).permutation(719)]
    files["train/rotations.npz"] = npz({"cyl": table})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert np.allclose(symsol_annot.load(made["cyl"].folder, "train")[17].rotation, table[17, 0], atol=1e-6)


def test_only_the_test_split_may_list_sets(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    files["train/rotations.npz"] = npz({"tet": arrays["tet", "train"][:, :1]})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert made["tet"].manifest.settings.annotate == "test"
    assert len(symsol_annot.load(made["tet"].folder)[0].symmetry_set) == 12
    assert symsol_annot.load(made["tet"].folder, "train")[0].symmetry_mask is None
    assert verify(made["tet"].folder) == []


def test_an_alpha_channel_is_left_out(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    pixels = arrays["tet", "test", "images"][2]
    files["test/images/tet_00002.png"] = png(np.dstack([pixels, np.full((16, 16), 7, dtype=np.uint8)]))
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[2].image, pixels)


class Shout:
    """Unpickled, it leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def npy(array, shape=None, descr=None):
    """An npy file, whose header may lie."""
    header = {"descr": descr or array.dtype.str, "fortran_order": False, "shape": shape or array.shape}
    data = io.BytesIO()
    np.lib.format.write_array_header_1_0(data, header)
    return data.getvalue() + array.tobytes()


def zip_of(files):
    data = io.BytesIO()
    write_zip(data, files)
    return data.getvalue()


def png_of_size(width, height):
    """A header that promises much, and nothing after it."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def png_header(width, height):
    return struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)


def with_chunk(data, kind, content):
    """A PNG with one more chunk behind its header."""
    chunk = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return data[:33] + chunk + data[33:]


def header_of(text):
    """A table whose array has a header of its own."""
    return zip_of({"tet.npy": b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text.encode()})


def _rotations(change, *splits):
    """A zip whose rotations of tet were changed, in train or where it is said."""

    def damage(files, arrays):
        for split in splits or ("train",):
            files[f"{split}/rotations.npz"] = npz({"tet": change(arrays["tet", split].astype("f8"))})

    return damage


def _set(table, where, value):
    table[where] = value
    return table


def _put(name, data):
    def damage(files, arrays):
        files[name] = data(files[name]) if callable(data) else data

    return damage


def _drop(name):
    def damage(files, arrays):
        del files[name]

    return damage


def _jpeg(_):
    data = io.BytesIO()
    Image.new("RGB", (16, 16)).save(data, format="JPEG")
    return data.getvalue()


def _table(*arguments, **options):
    return lambda _: zip_of({"tet.npy": npy(*arguments, **options)})


IMAGE, TABLE = "test/images/tet_00004.png", "test/rotations.npz"
IDENTITIES = np.broadcast_to(np.eye(3, dtype="f4"), (6, 12, 3, 3)).copy()
HOSTILE = {
    "an image is missing": (_drop(IMAGE), r"tet_00004.png is missing, though it has rotations"),
    "an image too many": (_put("test/images/tet_00006.png", png(np.zeros((16, 16, 3), np.uint8))), "has no rotations"),
    "images of no object's rotations": (_put("test/images/cube_00000.png", b""), "cube_00000.png has no rotations"),
    "no table": (_drop(TABLE), "test/rotations.npz is missing"),
    "a table that is no zip": (_put(TABLE, b"PK nothing"), "test/rotations.npz: File is not a zip file"),
    "a split without the object": (_put(TABLE, npz({"cube": IDENTITIES})), "has no cube, the other split has"),
    "no objects": (_put(TABLE, npz({})), "has no tet, the other split has"),
    "something else": (
        _put(TABLE, npz({"../../etc": IDENTITIES})),
        r"holds '\.\./\.\./etc\.npy', which is none of SYMSOL's objects",
    ),
    "objects": (_put(TABLE, npz({"tet": np.array([[None]])})), r"found \(1, 1\) of \|O"),
    "integers": (_put(TABLE, npz({"tet": IDENTITIES.astype("i4")})), "found .* of <i4"),
    "by columns": (_put(TABLE, npz({"tet": np.asfortranarray(IDENTITIES)})), "by columns"),
    "another shape": (_put(TABLE, npz({"tet": IDENTITIES[..., :2]})), r"expected an array \(n, m, 3, 3\)"),
    "a huge shape": (_put(TABLE, _table(IDENTITIES, (10**12, 12, 3, 3))), "beyond the 100000 images"),
    "a huge list": (_put(TABLE, _table(IDENTITIES, (6, 10**9, 3, 3))), "1000 rotations allowed"),
    "a negative shape": (_put(TABLE, _table(IDENTITIES, (-6, 12, 3, 3))), "expected an array"),
    "code for a header": (_put(TABLE, lambda _: zip_of({"tet.npy": b"\x93NUMPY\1\0\x10\0__import__('os')"})), "tet: "),
    "a table that ends": (_put(TABLE, _table(IDENTITIES[:3], (6, 12, 3, 3))), "ends before its last image"),
    "no rotation": (_rotations(lambda t: _set(t, 11, t[11] * 1.01)), "image 11: its rotation is none: off by 0.03"),
    "not a number": (_rotations(lambda t: _set(t, (11, 5, 0, 0), np.nan)), "image 11: its list is not R g"),
    "a stretched one": (_rotations(lambda t: _set(t, (11, 5), t[11, 5] * 1.01)), "image 11: its list is not R g"),
    "mirrored": (_rotations(lambda t: t * -1, "train", "test"), "image 0: its rotation is none: off by 2"),
    "another's": (_rotations(lambda t: _set(t, (11, 5), t[12, 5])), "image 11: its list is not R g"),
    "no common list": (_rotations(lambda t: _set(t, (4, 5), t[3, 5]), "test"), "of the first 6 images are not R g"),
    "no group": (_rotations(lambda t: t[:, :5], "train", "test"), "different rotations of a list make no group"),
    "an element lost": (_rotations(lambda t: t[:, :11]), "as many rotations per image in both splits"),
    "another size": (_put(IMAGE, png(np.zeros((16, 17, 3), np.uint8))), r"shape \(16, 17, 3\), the object's first"),
    "half a PNG": (_put(IMAGE, lambda data: data[: len(data) // 2]), "tet_00004.png: image file is truncated"),
    "no PNG": (_put(IMAGE, _jpeg), "tet_00004.png: is no PNG"),
    "nothing": (_put(IMAGE, b""), "tet_00004.png: is no PNG"),
    "grey": (_put(IMAGE, png(np.zeros((16, 16), np.uint8))), "PNG of mode L, expected 8-bit RGB"),
    "grey of 16 bits": (_put(IMAGE, png(np.zeros((16, 16), np.uint16))), "PNG of mode I;16"),
    "a giant": (_put(IMAGE, png_of_size(2**30, 2**30)), "1073741824 x 1073741824 pixels, expected 16 to 2048"),
    "a bomb": (_put(IMAGE, b"\0" * (2**25 + 1)), "is of 33554433 bytes in 3[0-9]{4}, as only a bomb is packed"),
    "a PNG and more": (
        _put(IMAGE, lambda data: data + np.random.default_rng(0).bytes(2**17)),
        "bytes, more than the 66560 allowed",
    ),
    "a PNG with two headers": (
        _put(IMAGE, lambda data: with_chunk(data, b"IHDR", png_header(2**14, 2**14))),
        "two hea",
    ),
    "a PNG without an end": (_put(IMAGE, lambda data: data[:-12]), "image file is truncated"),
    "a PNG with a chunk of 4 GB": (
        _put(IMAGE, lambda data: data[:33] + b"\xff\xff\xff\xffIDAT" + data[41:]),
        "image file is truncated",
    ),
    "a header of 4 GB": (_put(TABLE, lambda _: zip_of({"tet.npy": b"\x93NUMPY\2\0\xff\xff\xff\xff"})), "4294967295 by"),
    "a header of parentheses": (_put(TABLE, lambda _: header_of("(" * 9000)), "its header is none of an npy file"),
    "a header of signs": (_put(TABLE, lambda _: header_of("-" * 9000 + "1")), "its header is none of an npy file"),
    "a shape of 9,000 digits": (
        _put(TABLE, lambda _: header_of(f"{{'descr': '<f4', 'fortran_order': False, 'shape': (0x{'f' * 9000}, 1)}}")),
        "its header tells of no array of numbers",
    ),
    "a shape of true": (
        _put(TABLE, lambda _: header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (True, True, 3, 3)}")),
        "its header tells of no array of numbers",
    ),
    "a table of zeros": (
        _put(TABLE, bytes(2**24)),
        "rotations.npz: is of 16777216 bytes in .* as only a bomb is packed",
    ),
    "an array of zeros": (
        _put(TABLE, lambda _: zip_of({"tet.npy": npy(np.zeros((60_000, 12, 3, 3), "f4"))})),
        "as only a bomb is packed",
    ),
    "a zip in place of an array": (_put(TABLE, lambda data: zip_of({"tet.npy": data})), "is no npy file"),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    files, arrays = symsol_source.content(("tet",))
    damage(files, arrays)
    path = write_zip(tmp_path / "s.zip", files)
    with pytest.raises(DataError, match=message) as refused:
        imported(path, tmp_path / "sets")
    assert str(path) in str(refused.value)
    assert [there.name for there in tmp_path.iterdir()] == ["s.zip"]


def test_a_pickle_in_a_table_is_not_run(tmp_path):
    files, _ = symsol_source.content(("tet",))
    payload = np.empty((6, 12, 3, 3), dtype=object)
    payload[:] = Shout(tmp_path / "was-run")
    files[TABLE] = npz({"tet": payload})
    with pytest.raises(DataError, match="expected an array"):
        imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert not (tmp_path / "was-run").exists()
    pickle.loads(pickle.dumps(Shout(tmp_path / "was-run")))
    assert (tmp_path / "was-run").exists()


def test_a_zip_that_names_files_elsewhere_writes_none(tmp_path, source):
    path, _, _ = source
    inside = tmp_path / "deep" / "down"
    inside.mkdir(parents=True)
    files = {name: zipfile.ZipFile(path).read(name) for name in zipfile.ZipFile(path).namelist()}
    elsewhere = {"../../escaped.png": b"x", "/tmp/escaped": b"x", "test/images/../../tet_00000.png": b"x"}
    imported(write_zip(inside / "s.zip", {**files, **elsewhere}), inside / "sets", "tet")
    assert sorted(there.name for there in inside.iterdir()) == ["s.zip", "sets"]
    assert [there.name for there in (inside / "sets").iterdir()] == ["tet"]
    assert [there.name for there in tmp_path.iterdir()] == ["deep"]


EXTRAS = {
    "a profile that unpacks to a gigabyte": (b"iCCP", b"x\0\0" + zlib.compress(bytes(2**24), 9)),
    "a text that unpacks to a gigabyte": (b"zTXt", b"x\0\0" + zlib.compress(bytes(2**24), 9)),
    "an animation": (b"acTL", struct.pack(">II", 2**31 - 1, 0)),
    "a colour that is none": (b"tRNS", struct.pack(">HHH", 1, 2, 3)),
    "a chunk of nonsense": (b"eXIf", b"nonsense"),
}


@pytest.mark.parametrize(("kind", "content"), EXTRAS.values(), ids=EXTRAS)
def test_what_else_a_png_holds_changes_no_pixel(tmp_path, kind, content):
    files, arrays = symsol_source.content(("tet",))
    files[IMAGE] = with_chunk(files[IMAGE], kind, content)
    made = imported(write_zip(tmp_path / "s.zip", files, zipfile.ZIP_STORED), tmp_path / "sets")
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[4].image, arrays["tet", "test", "images"][4])


def test_an_interlaced_png_is_read_as_it_is(tmp_path):
    """Adam7 of 16 x 16 pixels of one colour: seven pictures of it, each row behind a filter's byte."""
    rows = [(-(-(16 - y) // dy), -(-(16 - x) // dx)) for x, y, dx, dy in ADAM7]
    data = b"".join((b"\0" + b"\x01\x02\x03" * width) * height for height, width in rows)
    files, _ = symsol_source.content(("tet",))
    head = struct.pack(">IIBBBBB", 16, 16, 8, 2, 0, 0, 1)
    plain = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in ((b"IHDR", head), (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    )
    files[IMAGE] = plain
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert (symsol_annot.load(made["tet"].folder)[4].image == (1, 2, 3)).all()


ADAM7 = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]


def test_a_zip_whose_list_of_files_is_a_bomb_is_refused_before_it_is_read(tmp_path):
    """A sparse gigabyte of list: 23 million names of nothing."""
    path = tmp_path / "s.zip"
    with path.open("wb") as file:
        file.truncate(2**30)
        file.seek(2**30)
        file.write(struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 2**30, 0, 0))
    with pytest.raises(DataError, match=r"list of files has 1,073,741,824 bytes, more than the 50,000,000"):
        imported(path, tmp_path / "sets")


def test_files_that_lie_over_each_other_are_refused(tmp_path):
    """As in the bombs of which every file is the same one, packed once."""
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", files, zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        first, second = (info.header_offset for info in file.infolist()[1:3])
    place = data.rindex(struct.pack("<I", second))
    data[place : place + 4] = struct.pack("<I", first)
    path.write_bytes(data)
    with pytest.raises(DataError, match="lie over each other"):
        imported(path, tmp_path / "sets")


UNLUCKY = [
    "/etc/passwd",
    "..\\..\\x.png",
    "C:\\x.png",
    "test/images/",
    "test/images/tet_0000٣.png",
    "a\x1b[2J",
    "x" * 60_000,
]


def test_names_of_any_kind_beside_the_sources_own_are_passed_over(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", {**files, **dict.fromkeys(UNLUCKY, b"x")})
    made = imported(path, tmp_path / "sets")
    assert sorted(there.name for there in tmp_path.iterdir()) == ["s.zip", "sets"]
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[4].image, arrays["tet", "test", "images"][4])


def test_many_thousand_names_are_read_in_time(tmp_path):
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", {**files, **{f"x{i}": b"" for i in range(70_000)}}, zipfile.ZIP_STORED)
    start = time.process_time()
    with SymsolZip(path) as source:
        assert source.objects == ("tet",)
    assert time.process_time() - start < 10.0


def test_a_zip_that_is_written_to_while_it_is_read_leaves_no_set(tmp_path):
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", files)

    def grow(_):
        with path.open("ab") as file:
            file.write(b"more")

    with pytest.raises(DataError, match="was changed while it was read"):
        imported(path, tmp_path / "sets", on_begin=grow)
    assert list((tmp_path / "sets").glob("*")) == []


def test_a_zip_that_is_replaced_while_it_is_read_is_read_to_its_end(tmp_path, source):
    files, _ = symsol_source.content(NAMES)
    path = write_zip(tmp_path / "s.zip", files)
    made = imported(
        path, tmp_path / "sets", "tet", on_begin=lambda _: Path(shutil.copy(__file__, tmp_path)).replace(path)
    )
    there = everything(made["tet"].folder)
    assert there.keys() == everything(source[2]["tet"].folder).keys()
    assert verify(made["tet"].folder) == []


def test_a_link_out_of_the_folder_is_not_written_through(source, tmp_path):
    path, _, _ = source
    folder = imported(path, tmp_path / "sets", "tet")["tet"].folder
    mine = tmp_path / "mine.h5"
    mine.write_text("mine")
    shard = folder / "test-00000-of-00001.h5"
    shard.unlink()
    shard.symlink_to(mine)
    with pytest.raises(OutputError, match="outside the set's folder; nothing was written"):
        imported(path, tmp_path / "sets", "tet")
    assert (mine.read_text(), shard.is_symlink()) == ("mine", True)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_zips_that_are_packed_in_odd_ways_are_refused(tmp_path):
    files, _ = symsol_source.content(("tet",))
    packed = write_zip(tmp_path / "bz2.zip", files, zipfile.ZIP_BZIP2)
    twice = write_zip(tmp_path / "twice.zip", files)
    with zipfile.ZipFile(twice, "a") as file:
        file.writestr(IMAGE, b"another")
    locked = tmp_path / "locked.zip"
    data = bytearray(write_zip(tmp_path / "plain.zip", files).read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1  # the flag of encryption
    locked.write_bytes(data)
    for path, message in ((packed, "another method than deflate"), (twice, "same name"), (locked, "encrypted")):
        with pytest.raises(DataError, match=message):
            imported(path, tmp_path / "sets")
    cut = tmp_path / "cut.zip"
    cut.write_bytes(data[: len(data) // 2])
    others = (
        (tmp_path / "none.zip", "no such file"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "is no reg"),
        (Path("/dev/zero"), "is no reg"),
        (tmp_path / "fifo", "is no reg"),
        (tmp_path / "plain.zip" / "x", "Not a directory"),
    )
    os.mkfifo(tmp_path / "fifo")
    for path, message in ((cut, "cannot be read as a zip"), *others):
        with pytest.raises(DataError, match=message):
            imported(path, tmp_path / "sets")
    assert not (tmp_path / "sets").exists()


@pytest.mark.parametrize("stop", [KeyboardInterrupt, DataError])
def test_an_import_that_is_stopped_leaves_whole_objects_alone(source, tmp_path, stop):
    path, _, made = source
    images = []

    def on_images(count):
        images.append(count)
        if sum(images) > 26:  # in the second object
            raise stop

    with pytest.raises(stop):
        imported(path, tmp_path / "sets", "tet", "cone", on_images=on_images)
    assert [there.name for there in (tmp_path / "sets").iterdir()] == ["tet"]
    assert everything(tmp_path / "sets" / "tet") == everything(made["tet"].folder)
    assert imported(path, tmp_path / "sets", "tet", "cone")["tet"].was_there
    assert everything(tmp_path / "sets" / "cone") == everything(made["cone"].folder)


def test_a_folder_of_somebodys_beside_the_sets_is_left_alone(source, tmp_path):
    path, _, _ = source
    theirs = tmp_path / "sets" / ".tet.partial"
    theirs.mkdir(parents=True)
    (theirs / "train-00000-of-00002.h5").write_bytes(b"mine")
    imported(path, tmp_path / "sets", "tet")
    assert sorted(there.name for there in (tmp_path / "sets").iterdir()) == [".tet.partial", "tet"]
    assert everything(theirs) == {"train-00000-of-00002.h5": b"mine"}


def _flip(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


LOSSES = {
    "missing": Path.unlink,
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "a bit flipped": _flip,
    "a link to nowhere": lambda path: path.unlink() or path.symlink_to("nowhere"),
}


@pytest.mark.parametrize("lose", LOSSES.values(), ids=LOSSES)
def test_an_import_that_lost_a_shard_is_made_again_by_the_same_command(source, here, tmp_path, lose):
    path, _, made = source
    words = ("import-symsol", path, "--out", tmp_path / "sets", "--object", "tet", "--object", "cone")
    here(*words)
    folder = tmp_path / "sets" / "tet"
    (folder / "notes.txt").write_text("mine")
    lose(folder / "test-00000-of-00001.h5")
    assert verify(folder) != []
    again = here(*words)
    assert (again.returncode, again.stderr.count("Error")) == (0, 0)
    assert [line.endswith("was there already") for line in again.stdout.splitlines()] == [False, True]
    found = everything(folder)
    assert found.pop("notes.txt") == b"mine"
    found.pop("nowhere", None)  # a link stays a link, and what it leads to is made
    assert found == everything(made["tet"].folder)
    assert here(*words).stdout.count("was there already") == 2


def test_another_set_is_not_overwritten(source, tmp_path):
    path, _, _ = source
    folder = make_set(tmp_path, "tet", test=2)
    before = everything(folder)
    with pytest.raises(DifferentSetError, match="source"):
        imported(path, tmp_path, "tet")
    assert everything(folder) == before
    (tmp_path / "cone").mkdir()
    (tmp_path / "cone" / "notes.txt").write_text("mine")
    with pytest.raises(DifferentSetError, match="and no manifest"):
        imported(path, tmp_path, "cone")
    assert [there.name for there in (tmp_path / "cone").iterdir()] == ["notes.txt"]


def test_an_imported_set_is_not_gone_on_with_by_rendering(source, tmp_path):
    path, _, _ = source
    folder = imported(path, tmp_path, "tet")["tet"].folder
    before = everything(folder)
    with pytest.raises(DifferentSetError, match="seed: there None, asked for 0"):
        generate(make_plan("tet", test=6, train=20, size=16), folder, threads(None))
    assert everything(folder) == before


def test_what_cannot_be_asked_is_said(source, here, tmp_path):
    path, _, _ = source
    with pytest.raises(SettingsError, match="has no cylO; it has tet, cone, cyl, tetX"):
        imported(path, tmp_path / "sets", "cylO")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        imported(path, tmp_path / "file", "tet")
    done = here("import-symsol", tmp_path / "file", "--out", tmp_path / "sets")
    assert (done.returncode, done.stdout) == (1, "")
    assert "File is not a zip file" in done.stderr
    assert not (tmp_path / "sets").exists()


def test_a_rendered_shard_does_not_pass_for_an_imported_one(source, tmp_path):
    path, _, _ = source
    rendered = make_set(tmp_path / "rendered", "tet", test=2)
    with h5py.File(rendered / "test-00000-of-00001.h5", "a") as file:
        file.attrs["source"] = "{}"
    with pytest.raises(DataError, match="attribute 'seed' is not part of an imported shard"):
        symsol_annot.load(rendered, check=False)[0]
    folder = imported(path, tmp_path, "tet")["tet"].folder
    with h5py.File(folder / "test-00000-of-00001.h5", "a") as file:
        file["segmentation"] = np.zeros((6, 16, 16), dtype="u1")
    with pytest.raises(DataError, match="'segmentation' is not part of an imported shard"):
        symsol_annot.load(folder, check=False)[0]


def test_a_manifest_that_invents_a_seed_is_refused(source, tmp_path):
    path, _, _ = source
    folder = imported(path, tmp_path, "tet")["tet"].folder
    manifest = read_manifest(folder)
    text = (folder / "manifest.json").read_text()
    (folder / "manifest.json").write_text(text.replace('"seed": null', '"seed": 0'))
    with pytest.raises(DataError, match="edited"):
        read_manifest(folder)
    assert manifest.is_imported


def test_float64_rotations_are_taken_as_well(tmp_path):
    files, arrays = symsol_source.content(("cone",), dtype="f8")
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert made["cone"].off_sets_rad < 1e-7
    assert rotations("cone", 1, np.random.default_rng(0), "f8").dtype == np.float64
    assert np.allclose(symsol_annot.load(made["cone"].folder)[0].rotation, arrays["cone", "test"][0, 0], atol=1e-12)
