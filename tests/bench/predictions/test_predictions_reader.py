"""Predictions files: what is valid is scored; each fault is named with its place, and all of a file's faults at once.

The files are written with h5py alone. Processes that read them are forked (fuzz_predictions.py), which is faster;
test_sandbox.py is about the processes that the product starts.
"""

import hashlib
import os
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from fuzz_predictions import (
    HYPOTHESES,
    IMAGES,
    LEVEL,
    STORAGE,
    forked_children,
    valid_attributes,
    valid_columns,
    write_file,
)
from made_sets import make_set

from symsol_annot import load
from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.report import to_document
from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, PredictionsError

CELLS = 72  # of the grid of level 0
MISSING = object()


@pytest.fixture(scope="module", autouse=True)
def _forked():
    with forked_children():
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder with a tetX set of 6 images."""
    folder = tmp_path_factory.mktemp("data")
    make_set(folder, "tetX", test=IMAGES)
    return folder


@pytest.fixture(scope="module")
def valid(data):
    """The columns and attributes of a file with all tracks."""
    dataset = load(data / "tetX")
    return valid_columns(dataset, np.random.default_rng(0)), valid_attributes(dataset)


@pytest.fixture
def scores(tmp_path, data, valid):
    """Write a file with some columns and attributes changed, then score it."""

    def score(columns=None, attributes=None, edit=lambda _: None, tracks=TRACKS, **stored):
        wanted = {"image_index", *(name for track in tracks for name in TRACKS[track].datasets)}
        merged = {**{name: valid[0][name] for name in valid[0] if name in wanted}, **(columns or {})}
        attrs = {**valid[1], **(attributes or {})}
        write_file(
            tmp_path / "preds.h5",
            {name: column for name, column in merged.items() if column is not MISSING},
            {name: value for name, value in attrs.items() if value is not MISSING},
            **stored,
        )
        with h5py.File(tmp_path / "preds.h5", "r+") as file:
            edit(file)
        return score_file(tmp_path / "preds.h5", data)

    return score


@pytest.fixture
def faults(scores):
    """Score a file that must have faults, as `scores` takes them; return them, one per line."""

    def refused(*arguments, **keywords):
        with pytest.raises(PredictionsError) as caught:
            scores(*arguments, **keywords)
        assert str(caught.value).count("\n  - ") == len(caught.value.faults)
        assert all(line.isprintable() for line in str(caught.value).split("\n"))
        return "\n".join(caught.value.faults)

    return refused


def figures(scored):
    """Return every figure of every track, over all images."""
    return {
        (name, metric): figure.value
        for name, track in scored.tracks.items()
        for metric, figure in track.figures["all"].items()
    }


def changed(column, at, value):
    """Return a copy with something else at a place."""
    copy = np.array(column)
    copy[at] = value
    return copy


def with_rows(*rows):
    """Return offsets and a joined column of these rows."""
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    return offsets, np.concatenate([np.asarray(row, dtype=np.asarray(rows[0]).dtype) for row in rows])


# The file, while it is read


def replaced_by_itself(path):
    copy = path.with_suffix(".copy")
    shutil.copyfile(path, copy)
    copy.replace(path)


@pytest.mark.parametrize("change", [lambda path: os.utime(path, (0, 0)), replaced_by_itself, Path.unlink])
def test_a_file_that_is_changed_or_replaced_before_it_was_read_to_its_end_is_refused(scores, tmp_path, data, change):
    scores()
    path = tmp_path / "preds.h5"

    def check_and_change():
        with open_predictions(path, data) as predictions:
            predictions.check()
            change(path)

    with pytest.raises(PredictionsError, match="the file: was changed while it was read"):
        check_and_change()


def test_scores_have_the_digest_of_the_file_that_was_read_whatever_becomes_of_it(scores, tmp_path):
    scored = scores(tracks=["hypotheses"])
    path = tmp_path / "preds.h5"
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    path.unlink()
    document = to_document([scored])["objects"]["tetX"]
    assert document["predictions"] == {"file": "preds.h5", "sha256": sha256}


# What is valid


@pytest.mark.parametrize("libver", [("earliest", "v108"), ("latest", "latest")], ids=["old", "new"])
@pytest.mark.parametrize("storage", STORAGE)
def test_a_score_does_not_depend_on_how_a_file_is_stored(scores, storage, libver):
    assert figures(scores(storage=STORAGE[storage], libver=libver)) == pytest.approx(figures(scores()), nan_ok=True)


@pytest.mark.parametrize("types", [{"f": ">f8", "i": ">i8"}, {"f": "<f4", "i": "<i4"}, {"f": ">f4", "i": ">i4"}])
def test_a_score_does_not_depend_on_the_order_of_bytes_and_hardly_on_their_number(scores, valid, types):
    columns = {name: column.astype(types[column.dtype.kind]) for name, column in valid[0].items()}
    expected = figures(scores(valid[0], attributes={"floor": 0.05}))
    assert figures(scores(columns, attributes={"floor": 0.05})) == pytest.approx(expected, nan_ok=True, abs=1e-5)


def test_a_score_does_not_depend_on_the_order_of_the_rows(scores, valid):
    order = np.array([3, 1, 0, 5, 4, 2])
    columns = {name: column[order] for name, column in valid[0].items() if len(column) == IMAGES}
    for track in "grid", "density":
        names = [name for name in valid[0] if name.startswith(f"{track}_") and "offsets" not in name]
        for name in names:
            rows = np.split(valid[0][name], valid[0][f"{track}_offsets"][1:-1])
            columns[f"{track}_offsets"], columns[name] = with_rows(*(rows[r] for r in order))
    assert figures(scores(columns)) == pytest.approx(figures(scores()), nan_ok=True)


def test_chunks_may_be_larger_than_the_data_and_a_file_may_begin_late(scores, tmp_path, data):
    expected = figures(scores())

    def store_again(file):
        column = file["image_index"][...]
        del file["image_index"]
        file.create_dataset("image_index", data=column, chunks=(4096,), maxshape=(None,), compression="gzip")

    assert figures(scores(edit=store_again)) == pytest.approx(expected, nan_ok=True)
    late = tmp_path / "late.h5"
    late.write_bytes(bytes(2**20) + (tmp_path / "preds.h5").read_bytes())
    assert figures(score_file(late, data)) == pytest.approx(expected, nan_ok=True)


def test_a_committed_type_elsewhere_in_the_file_is_a_fault_of_its_own_name_alone(faults, valid):
    def commit(file):
        file["real"] = np.dtype("f8")
        del file["hypothesis_weights"]
        shape = valid[0]["hypothesis_weights"].shape
        file.create_dataset("hypothesis_weights", shape, file["real"])[...] = valid[0]["hypothesis_weights"]

    assert faults(edit=commit) == "the file: 'real' is not part of the format"


def test_hypotheses_of_weight_0_may_be_anything(scores, valid):
    absent = np.zeros((IMAGES, HYPOTHESES))
    absent[:, 0] = 1.0
    hypotheses = changed(valid[0]["hypotheses"], np.s_[:, 1:], np.nan)
    first = scores({"hypotheses": valid[0]["hypotheses"][:, :1], "hypothesis_weights": MISSING})
    found, expected = figures(scores({"hypotheses": hypotheses, "hypothesis_weights": absent})), figures(first)
    shared = {key for key in expected if key[0] == "hypotheses"}
    assert {key for key in found if key[0] == "hypotheses"} - shared == {("hypotheses", F_UNWEIGHTED)}
    assert {key: found[key] for key in shared} == pytest.approx({key: expected[key] for key in shared})


@pytest.mark.parametrize("factor", [5e-324, 1e-310, 1e300, 1e308])
def test_a_score_does_not_depend_on_the_size_of_the_weights(scores, valid, factor):
    """Angles times denormal weights would vanish, and sums of the largest be infinite."""
    weights = np.array(valid[0]["hypothesis_weights"] > 0, dtype=np.float64)
    expected = figures(scores({"hypothesis_weights": weights}))
    assert figures(scores({"hypothesis_weights": weights * factor})) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("track", TRACKS)
def test_a_file_may_hold_one_track(scores, track):
    assert list(scores(tracks=[track]).tracks) == [track]


def test_a_density_may_list_every_cell(scores):
    offsets, indices = with_rows(*[np.arange(CELLS)] * IMAGES)
    logs = np.full(len(indices), -np.log(CELLS))
    logs[::CELLS] = -700.0
    logs[1::CELLS] = np.log(2 / CELLS)
    columns = {"density_offsets": offsets, "density_indices": indices, "density_log_probabilities": logs}
    assert all(np.isfinite(value) for value in figures(scores(columns, tracks=["density"])).values())


# Attributes

ATTRIBUTES = {
    "another format": (
        {"format": "symsol-annot scores"},
        "'format': expected 'symsol-annot predictions', found 'symsol",
    ),
    "no format": ({"format": MISSING}, "'format': expected 'symsol-annot predictions', found None"),
    "a version in words": ({"format_version": "1"}, "'format_version': expected a whole number, found '1'"),
    "half a version": ({"format_version": 1.5}, "'format_version': expected a whole number, found 1.5"),
    "two versions": ({"format_version": [1, 2]}, "'format_version' is not a whole number but an array of shape (2,)"),
    "no method": ({"method": MISSING}, "'method' is missing; it is a string"),
    "a number as method": ({"method": 3}, "'method': expected a string, found 3"),
    "a list as method": ({"method": ["a", "b"]}, "'method' is not a string but an array of shape (2,)"),
    "nothing as method": ({"method": h5py.Empty("S1")}, "'method' is not a string but empty"),
    "a truth value as method": ({"method": True}, "'method' is not a string but enumerations or booleans"),
    "a compound as method": ({"method": np.zeros((), "i4,f8")}, "'method' is not a string but compounds"),
    "opaque bytes as method": ({"method": np.void(b"abc")}, "'method' is not a string but opaque bytes"),
    "a huge method": (
        {"method": "x" * 60000},
        "'method': expected 1 to 200 printable characters, not all of them spaces, found 'xxx",
    ),
    "a terminal's codes": (
        {"method": "\x1b[2J\x07"},
        "'method': expected 1 to 200 printable characters, not all of them spaces, found '\\x1b[",
    ),
    "text that turns round": (
        {"method": "a\u202eb"},
        "'method': expected 1 to 200 printable characters, not all of them spaces, found 'a\\u20",
    ),
    "no object": ({"object": MISSING}, "'object': expected the name of an object, found None"),
    "a number as object": ({"object": 1}, "'object': expected the name of an object, found 1"),
    "a path as object": ({"object": "../tetX"}, "'object': expected the name of an object, found '../tetX'"),
    "dots as object": ({"object": ".."}, "'object': expected the name of an object, found '..'"),
    "a long object": ({"object": "x" * 5000}, "'object': expected the name of an object, found 'xxx"),
    "control codes as object": ({"object": "\x1b[2J"}, "'object': expected the name of an object, found '\\x1b[2J'"),
    "another split": ({"split": "validation"}, "'split': expected one of train, test, found 'validation'"),
    "no split": ({"split": MISSING}, "'split': expected one of train, test, found None"),
    "another set": ({"fingerprint": "0"}, "found '0'; the file is about another data set, or another version of it"),
    "a number as fingerprint": ({"fingerprint": 1.0}, "'fingerprint': expected a string, found 1.0"),
    "another group": ({"group_sha256": "0"}, "found '0'; the queries were asked in the order of another group"),
    "another grid": ({"grid_sha256": "0"}, "found '0'; the grid is another one, or in another order"),
    "no level": ({"grid_level": MISSING}, "'grid_level' is missing; it is a whole number"),
    "a level in words": ({"grid_level": "0"}, "'grid_level': expected a whole number, found '0'"),
    "half a level": ({"grid_level": 0.5}, "'grid_level': expected a whole number, found 0.5"),
    "a truth value as level": (
        {"grid_level": False},
        "'grid_level' is not a whole number but enumerations or booleans",
    ),
    "a negative level": ({"grid_level": -1}, "'grid_level': expected 0 to 5, found -1"),
    "a level too high": ({"grid_level": 6}, "'grid_level': expected 0 to 5, found 6"),
    "a huge level": ({"grid_level": 2**63 - 1}, "'grid_level': expected 0 to 5, found 9223372036854775807"),
    "a NaN level": ({"grid_level": np.nan}, "'grid_level': expected a whole number, found nan"),
    "a floor too high": ({"floor": 0.81}, "'floor': expected 0 to 0.8, found 0.81"),
    "a negative floor": ({"floor": -0.1}, "'floor': expected 0 to 0.8, found -0.1"),
    "a NaN floor": ({"floor": np.nan}, "'floor': expected 0 to 0.8, found nan"),
    "an infinite floor": ({"floor": np.inf}, "'floor': expected 0 to 0.8, found inf"),
    "a floor in words": ({"floor": "0.1"}, "'floor': expected a number, found '0.1'"),
    "no floor": ({"floor": MISSING}, "'floor' is missing; it is a number"),
    "a complex floor": ({"floor": np.complex64(0.1)}, "'floor' is not a number but c"),
}
TRACK_OF = {"grid_level": ("classifier", "density"), "grid_sha256": ("classifier", "density")}
TRACK_OF |= {"group_sha256": ("classifier",), "floor": ("classifier",)}


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_a_wrong_attribute_is_named_with_its_track_and_with_what_was_expected_and_found(faults, name):
    attributes, message = ATTRIBUTES[name]
    (attribute,) = attributes
    found = faults(attributes=attributes).splitlines()
    assert {line.split(": ")[0] for line in found} == set(TRACK_OF.get(attribute, ["the file"]))
    assert all(f"attribute {attribute!r}" in line for line in found)
    assert all(message in line for line in found if "expected 0 to" not in line), found
    assert any(message in line for line in found)


@pytest.mark.parametrize(
    ("version", "said"),
    [
        (2, "the file: is of format version 2, newer than 1, which this symsol-annot reads: update it"),
        (0, "the file: this version reads format_version 1, found 0"),
    ],
)
def test_another_format_version_is_refused_and_a_later_one_says_what_to_do(faults, version, said):
    assert said in faults(attributes={"format_version": version})


def test_a_floor_may_be_a_long_double_or_a_whole_number(scores):
    scores(attributes={"floor": np.longdouble(1) / 16})
    scores(attributes={"floor": 0})
    scores(attributes={"method": np.bytes_(b"in bytes"), "grid_level": np.uint8(LEVEL)})


def test_a_method_that_is_no_text_is_a_fault(faults):
    def set_bytes(file):
        file.attrs.create("method", b"a\xff", dtype=h5py.string_dtype())

    found = faults(edit=set_bytes)
    rule = "expected 1 to 200 printable characters, not all of them spaces"
    assert found == rf"the file: attribute 'method': {rule}, found 'a\udcff'"


def test_an_object_that_data_does_not_hold_is_a_fault_of_data(scores, data):
    with pytest.raises(DataError, match="holds no set of the object 'cube'"):
        scores(attributes={"object": "cube"})


def test_an_object_of_another_set_is_named_where_data_is_a_set(scores, tmp_path, data):
    with pytest.raises(DataError):
        scores(attributes={"object": "cylO"})
    with pytest.raises(PredictionsError, match="'object': expected 'tetX', found 'cylO'; --data names"):
        score_file(tmp_path / "preds.h5", data / "tetX")


# Data sets


def replaced(name, **how):
    """Return what puts another data set in the place of one."""

    def replace(file):
        del file[name]
        file.create_dataset(name, **how)

    return replace


def linked(name, link):
    """Return what puts a link in the place of a data set."""

    def replace(file):
        del file[name]
        file[name] = link

    return replace


SHAPE = (IMAGES, HYPOTHESES, 3, 3)
NO_NUMBERS = {
    "truth values": (np.bool_, "a data set of enumerations or booleans"),
    "an enumeration": (h5py.enum_dtype({"a": 0}), "a data set of enumerations or booleans"),
    "strings": (h5py.string_dtype(), "a data set of strings"),
    "strings of 8": ("S8", "a data set of strings"),
    "compounds": (np.dtype("f4,f4"), "a data set of compounds"),
    "object references": (h5py.ref_dtype, "a data set of references"),
    "region references": (h5py.regionref_dtype, "a data set of references"),
    "variable lengths": (h5py.vlen_dtype("f8"), "a data set of variable-length rows"),
    "opaque bytes": ("V8", "a data set of opaque bytes"),
    "arrays": (np.dtype(("f8", (2,))), "a data set of array types"),
}


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_holds_no_plain_numbers_is_not_read(faults, kind):
    dtype, what = NO_NUMBERS[kind]
    found = faults(edit=replaced("hypotheses", shape=SHAPE, dtype=dtype))
    assert found == f"hypotheses: 'hypotheses' is {what}, where a data set of numbers in this file belongs"


NUMBERS = ("f2", "g", "i4", "i8", "u1", ">i2")


@pytest.mark.parametrize("dtype", NUMBERS)
def test_hypotheses_of_another_type_are_named_with_it(faults, dtype):
    found = faults(edit=replaced("hypotheses", shape=SHAPE, dtype=dtype))
    size = np.dtype(dtype).str[1:]
    shape = f"({IMAGES}, M, 3, 3), found {size} of shape ({IMAGES}, {HYPOTHESES}, 3, 3)"
    assert found.startswith(f"hypotheses: 'hypotheses': expected f4 or f8 of shape {shape}; ")


SHAPES = {
    "a matrix an image": (IMAGES, 3, 3),
    "nine numbers": (IMAGES, 9),
    "nine numbers a hypothesis": (IMAGES, HYPOTHESES, 9),
    "an axis more": (1, *SHAPE),
    "an image less": (IMAGES - 1, *SHAPE[1:]),
    "an image more": (IMAGES + 1, *SHAPE[1:]),
    "no image": (0, *SHAPE[1:]),
    "one number": (),
    "4 by 4": (IMAGES, HYPOTHESES, 4, 4),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_hypotheses_of_another_shape_are_named_with_it(faults, kind):
    found = faults(edit=replaced("hypotheses", shape=SHAPES[kind], dtype="f8"))
    assert f"expected f4 or f8 of shape ({IMAGES}, M, 3, 3), found f8 of shape {SHAPES[kind]}" in found
    assert ("4x4 poses" in found) == (kind == "4 by 4")


@pytest.mark.parametrize("shape", [(IMAGES, 4), (IMAGES, HYPOTHESES, 4)])
def test_quaternions_in_place_of_matrices_are_called_so(faults, shape):
    found = faults(edit=replaced("hypotheses", shape=shape, dtype="f8"))
    assert "; these look like quaternions: " in found


@pytest.mark.parametrize(("count", "dtype"), [(0, "f8"), (10_001, "f4")])
def test_too_few_or_too_many_hypotheses_are_counted(faults, count, dtype):
    stored = {"shape": (IMAGES, count, 3, 3), "dtype": dtype}
    found = faults({"hypothesis_weights": MISSING}, edit=replaced("hypotheses", **stored))
    assert found == f"hypotheses: M = {count}: 1 to 10000 hypotheses per image are read"


@pytest.mark.parametrize("name", ["hypotheses", "query_probability", "grid_offsets", "density_indices", "image_index"])
def test_a_data_set_without_a_space_of_values_is_none(faults, name):
    assert f"'{name}' is a data set without values" in faults(edit=replaced(name, data=h5py.Empty("f8")))


@pytest.mark.parametrize("track", TRACKS)
def test_every_missing_data_set_is_named(faults, track):
    for name in TRACKS[track].datasets:
        if name != "hypothesis_weights":
            found = faults({name: MISSING})
            assert found.startswith(f"{track}: data set '{name}' is missing"), found


def test_a_file_without_tracks_or_images_says_so(faults):
    assert faults(tracks=[]).startswith("the file: has no track: none of the data sets hypotheses, query_probability,")
    missing = "the file: data set 'image_index' is missing; f['image_index'] = range(6) where rows are in order"
    assert faults({"image_index": MISSING}) == missing


def test_scalars_where_columns_belong_are_named(faults, valid):
    found = faults({name: np.array(1) for name in valid[0]})
    assert [line.split("'")[1] for line in found.splitlines()] == list(valid[0])
    assert all(line.endswith(" of shape ()") for line in found.splitlines()), found


@pytest.mark.parametrize(
    ("index", "message"),
    [
        ([0, 1, 2, 3, 4], "1 of the 6 images are missing: 5"),
        ([0, 1, 2, 3, 4, 4], "1 of the 6 images are there more than once: 4"),
        ([0, 1, 2, 3, 4, 5, 5], "1 of the 6 images are there more than once: 5"),
        ([0, 1, 2, 3, 4, 6], "1 rows are about images outside the 6 of the split: 6"),
        ([0, 1, 2, 3, 4, -1], "1 rows are about images outside the 6 of the split: -1"),
        ([0, 1, 2, 3, 4, 2**63 - 1], "1 rows are about images outside the 6 of the split: 9223372036854775807"),
        ([], "6 of the 6 images are missing: 0, 1, 2, 3, 4, ..."),
    ],
)
def test_images_that_are_missing_double_or_strange_are_listed(faults, index, message):
    assert f"the file: 'image_index': {message}" in faults({"image_index": np.array(index, dtype=np.int64)})


@pytest.mark.parametrize("dtype", ["f8", "u8", "i2"])
def test_an_image_index_of_another_type_is_named_with_it(faults, valid, dtype):
    found = faults({"image_index": valid[0]["image_index"].astype(dtype)})
    said = f"expected i4 or i8 or u4 of shape (N), found {dtype} of shape (6,)"
    assert found == f"the file: 'image_index': {said}; write np.asarray(image_index, dtype=np.int64)"


def test_far_too_many_rows_are_counted_and_not_read(faults):
    huge = replaced("image_index", shape=(3000,), dtype="i8")
    assert faults(edit=huge) == "the file: has 3000 rows; the test split has 6 images"


# Values


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_hypotheses_that_are_not_finite_are_named_by_row(faults, valid, value):
    hypotheses = changed(valid[0]["hypotheses"], ([1, 4], [2, 0], 0, 1), value)
    assert faults({"hypotheses": hypotheses}) == "hypotheses: 'hypotheses' has a NaN or an infinite entry: rows 1, 4"


def test_signalling_nans_are_nans(faults, valid):
    for name in ("hypotheses", "query_probability", "grid_probabilities", "density_log_probabilities"):
        column = valid[0][name].astype(np.float32)
        column.reshape(-1).view(np.uint32)[0] = 0x7FA00000
        assert f"'{name}'" in faults({name: column})


NO_ROTATIONS = {
    "a reflection": (np.diag([1.0, 1.0, -1.0]), "off by 2, with determinant -1"),
    "a stretched one": (np.diag([1.01, 1.0, 1.0]), "off by 0.02"),
    "a singular one": (np.zeros((3, 3)), "off by 1"),
    "a sheared one": (np.eye(3) + 0.3 * np.eye(3, k=1), "off by 0.3"),
    "a huge one": (np.full((3, 3), 1e200), "off by inf"),
    "a tiny one": (5e-318 * np.array([[0, 1, 1], [1, 2, 3], [1, 3, 2]]), "off by 1"),
    "one whose determinant is NaN": (1.7e308 * np.array([[0, 0, 1], [-1, 1, 1], [1, -1, 1]]), "off by inf"),
}


@pytest.mark.parametrize("kind", NO_ROTATIONS)
def test_matrices_that_are_no_rotations_are_named_by_row_and_by_how_far_off_they_are(faults, valid, kind):
    matrix, off = NO_ROTATIONS[kind]
    found = faults({"hypotheses": changed(valid[0]["hypotheses"], (3, 1), matrix)})
    rule = "(R^T R = I and det R = 1 within 0.0001)"
    mend = "; project what was rounded: U, _, Vt = np.linalg.svd(R.astype(np.float64)); R = U @ Vt"
    rule += mend if kind == "a stretched one" else ""
    assert found == f"hypotheses: 'hypotheses' holds a matrix that is no rotation {rule}: row 3 (hypothesis 1, {off})"


@pytest.mark.parametrize(("dtype", "tolerance"), [("f4", 1e-4), ("f8", 1e-4)])
def test_a_rotation_may_be_as_far_off_as_its_type_allows(scores, faults, valid, dtype, tolerance):
    def off_by(amount):
        stretched = valid[0]["hypotheses"] * (1 + amount / 3)  # det R is then off by the amount
        return {"hypotheses": stretched.astype(dtype)}

    scores(off_by(0.9 * tolerance))
    assert f"within {tolerance:g}); project what was rounded: " in faults(off_by(1.1 * tolerance))


def test_transposes_of_rotations_are_rotations_and_score_worse(scores, valid):
    right = scores(tracks=["hypotheses"])
    wrong = scores({"hypotheses": np.swapaxes(valid[0]["hypotheses"], 2, 3)}, tracks=["hypotheses"])
    key = ("hypotheses", "precision_mean_error_rad")
    assert figures(right)[key] < 1e-6 < figures(wrong)[key]


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        ((2, 1), -0.1, "are not all finite and at least 0: row 2"),
        ((2, 1), np.nan, "are not all finite and at least 0: row 2"),
        ((5, 0), np.inf, "are not all finite and at least 0: row 5"),
        ((2,), 0.0, "has no positive one: row 2"),
    ],
)
def test_weights_that_weigh_nothing_are_named_by_row(faults, valid, at, value, reason):
    weights = changed(valid[0]["hypothesis_weights"], at, value)
    assert faults({"hypothesis_weights": weights}) == f"hypotheses: 'hypothesis_weights' {reason}"


def test_weights_of_another_shape_are_named_with_it(faults, valid):
    found = faults({"hypothesis_weights": valid[0]["hypothesis_weights"][:, :2]})
    assert found.endswith("expected f4 or f8 of shape (6, 3), found f8 of shape (6, 2)")
    assert faults({"hypotheses": MISSING}) == "hypotheses: data set 'hypotheses' is missing"


@pytest.mark.parametrize("value", [-1e-9, 1.0001, np.nan, np.inf, -np.inf])
def test_probabilities_outside_0_to_1_are_named_by_row(faults, valid, value):
    asked = changed(valid[0]["query_probability"].astype(np.float64), (4, 7), value)
    mend = "; write np.clip(p, 0, 1)" if np.isfinite(value) else ""
    assert faults({"query_probability": asked}) == f"classifier: 'query_probability' is not in [0, 1]{mend}: row 4"
    row = int(np.flatnonzero(np.diff(valid[0]["grid_offsets"]))[1])
    at = valid[0]["grid_offsets"][row]
    found = faults({"grid_probabilities": changed(valid[0]["grid_probabilities"], at, value)})
    assert found == f"classifier: 'grid_probabilities' are not above the floor 0.1 and at most 1: row {row}"


def test_a_listed_probability_at_the_floor_is_a_fault(faults, valid):
    column = changed(valid[0]["grid_probabilities"].astype(np.float64), 0, 0.1)
    assert "'grid_probabilities' are not above the floor 0.1 and at most 1" in faults({"grid_probabilities": column})


def test_another_number_of_queries_is_named_with_what_belongs_there(faults, valid):
    found = faults({"query_probability": valid[0]["query_probability"][:, :12]})
    assert found.endswith("expected f4 or f8 of shape (6, 108), found f4 of shape (6, 12)")


GRID = {"classifier": ("grid", "grid_probabilities", 0.5), "density": ("density", "density_log_probabilities", -5.0)}
UNSORTED = "are not ascending, or one is repeated"
INDICES = {
    "unsorted": ([1, 0], UNSORTED),
    "repeated": ([7, 7], UNSORTED),
    "negative": ([-1, 0], "has an index outside 0 to 71"),
    "out of range": ([0, CELLS], "has an index outside 0 to 71"),
    "far out of range": ([0, 2**63 - 1], "has an index outside 0 to 71"),
}


def sparse(track, rows):
    prefix, values, value = GRID[track]
    offsets, indices = with_rows(*rows)
    return {f"{prefix}_offsets": offsets, f"{prefix}_indices": indices, values: np.full(len(indices), value)}


@pytest.mark.parametrize("track", GRID)
@pytest.mark.parametrize("kind", INDICES)
def test_grid_indices_that_are_unsorted_repeated_or_outside_are_named_by_row(faults, track, kind):
    indices, reason = INDICES[kind]
    found = faults(sparse(track, [[3], [], [70, 71], indices, [0], []]))
    assert found == f"{track}: '{GRID[track][0]}_indices' {reason}: row 3"


@pytest.mark.parametrize("track", GRID)
def test_indices_may_fall_from_one_image_to_the_next(scores, track):
    scores(sparse(track, [[70, 71], [], [0, 1], [0], [], []]))


OFFSETS = {
    "a late start": [1, 1, 2, 3, 4, 5, 6],
    "an early end": [0, 1, 2, 3, 4, 5, 5],
    "a late end": [0, 1, 2, 3, 4, 5, 7],
    "a step back": [0, 3, 2, 3, 4, 5, 6],
    "a negative one": [0, -1, 2, 3, 4, 5, 6],
    "a wrap around": [0, 2**63 - 1, -(2**63), 3, 4, 5, 6],
}


@pytest.mark.parametrize("track", GRID)
@pytest.mark.parametrize("kind", OFFSETS)
def test_offsets_that_do_not_ascend_from_end_to_end_are_named(faults, track, kind):
    columns = sparse(track, [[1]] * IMAGES)
    name = f"{GRID[track][0]}_offsets"
    found = faults({**columns, name: np.array(OFFSETS[kind])})
    assert found.startswith(
        f"{track}: '{name}': expected ascending numbers from 0 to 6 with steps of at most 72, found"
    )


@pytest.mark.parametrize("track", GRID)
def test_an_image_cannot_list_more_cells_than_there_are(faults, track):
    found = faults(sparse(track, [np.arange(CELLS + 1), *[[]] * (IMAGES - 1)]))
    assert "with steps of at most 72, found 0 to 73 with steps of 0 to 73" in found


@pytest.mark.parametrize("track", GRID)
def test_indices_and_values_must_be_as_many(faults, track):
    columns = sparse(track, [[1]] * IMAGES)
    name = GRID[track][1]
    assert faults({**columns, name: columns[name][:-1]}).endswith("_indices' has 6 entries, but '" + f"{name}' 5")


@pytest.mark.parametrize("track", GRID)
def test_offsets_of_another_length_or_type_are_named_with_them(faults, track):
    columns, name = sparse(track, [[1]] * IMAGES), f"{GRID[track][0]}_offsets"
    assert "expected i8 or i4 of shape (7), found i8 of shape (6,)" in faults({**columns, name: columns[name][:-1]})
    assert "found f8 of shape (7,)" in faults({**columns, name: columns[name].astype("f8")})


@pytest.mark.parametrize("value", [1e-9, 0.5, np.nan, np.inf, -np.inf, -1.1e6, -1e308])
def test_log_probabilities_that_are_none_or_vanish_are_named_by_row(faults, value):
    columns = sparse("density", [[1]] * IMAGES)
    columns["density_log_probabilities"][3] = value
    found = faults(columns)
    assert found.startswith("density: 'density_log_probabilities' are not in [-1e+06, 0]")
    assert found.endswith(": row 3")


def test_a_density_must_leave_something_to_the_cells_that_it_does_not_list(faults):
    columns = sparse("density", [[0], [1, 2], [3, 4], [], [5], []])
    columns["density_log_probabilities"][:5] = [-0.1, *np.log([0.5, 0.5, 0.7, 0.7])]
    found = faults(columns)
    assert "image's scipy.special.logsumexp over the whole grid: rows 1 (they hold 1), 2 (they hold 1.4)" in found


def test_a_density_that_lists_every_cell_must_add_up_to_1(faults):
    columns = sparse("density", [np.arange(CELLS), [], [], [], [], []])
    columns["density_log_probabilities"][:] = np.log(0.9 / CELLS)
    assert faults(columns).endswith("logsumexp over the whole grid: row 0 (they hold 0.9)")


def test_rows_that_share_a_fault_are_counted_and_the_first_of_them_named(faults, valid):
    asked = changed(valid[0]["query_probability"], np.s_[:, 0], 2.0)
    assert faults({"query_probability": asked}).endswith("(1 + np.exp(-x)): rows 0, 1, 2, 3, 4 and 1 more")


def test_all_faults_of_a_file_are_listed_at_once(faults, valid):
    columns = {
        "hypotheses": changed(valid[0]["hypotheses"], (1, 0), -np.eye(3)),
        "hypothesis_weights": changed(valid[0]["hypothesis_weights"], 2, 0.0),
        "query_probability": changed(valid[0]["query_probability"], (3, 0), 7.0),
        **sparse("density", [[5, 5], [CELLS], [], [], [], []]),
        "notes": np.zeros(3),
    }
    found = faults(columns, {"method": MISSING, "fingerprint": "0"}, edit=linked("grid_indices", h5py.SoftLink("/x")))
    expected = [
        "the file: 'notes' is not part of the format",
        "classifier: 'grid_indices' is a soft link to '/x', where a data set of numbers in this file belongs",
        "the file: attribute 'method' is missing",
        "the file: attribute 'fingerprint': expected",
        "hypotheses: 'hypothesis_weights' has no positive one: row 2",
        "hypotheses: 'hypotheses' holds a matrix that is no rotation",
        "density: 'density_indices' has an index outside 0 to 71: row 1",
        "density: 'density_indices' are not ascending, or one is repeated: row 0",
    ]
    assert len(found.splitlines()) == len(expected)
    assert all(any(line.startswith(what) for line in found.splitlines()) for what in expected), found


# What reaches out of the file, or is more than it seems

LINKS = {
    "an external link": (h5py.ExternalLink("canary.h5", "hypotheses"), "a link into another file, 'canary.h5'"),
    "a soft link": (h5py.SoftLink("/image_index"), "a soft link to '/image_index'"),
    "a soft link to itself": (h5py.SoftLink("/hypotheses"), "a soft link to '/hypotheses'"),
    "a soft link over another file": (h5py.SoftLink("/out/hypotheses"), "a soft link to '/out/hypotheses'"),
    "a type": (np.dtype("f8"), "a named type"),
}


@pytest.mark.parametrize("kind", LINKS)
def test_links_are_named_with_their_target_and_not_followed(faults, kind):
    link, what = LINKS[kind]
    found = faults(edit=linked("hypotheses", link))
    assert found == f"hypotheses: 'hypotheses' is {what}, where a data set of numbers in this file belongs"


def test_a_link_to_the_root_is_a_group(faults):
    def put(file):
        del file["hypotheses"]
        file["hypotheses"] = file["/"]

    assert "'hypotheses' is a group, where" in faults(edit=put)


def test_groups_are_not_looked_into(faults):
    def put(file):
        file.create_group("model")["hypotheses"] = h5py.ExternalLink("canary.h5", "/")

    assert faults(edit=put) == "the file: 'model' is not part of the format"


FILTERS = {
    "lzf": ({"compression": "lzf"}, 32000),
    "scaleoffset": ({"scaleoffset": 4}, 6),
    "szip": ({"compression": "szip"}, 4),
}


@pytest.mark.parametrize("name", FILTERS)
def test_filters_that_not_every_build_has_are_named(faults, valid, name):
    stored, number = FILTERS[name]
    if name == "szip" and not h5py.h5z.filter_avail(h5py.h5z.FILTER_SZIP):
        pytest.skip("this build of HDF5 has no szip")
    found = faults(edit=replaced("hypotheses", data=valid[0]["hypotheses"], chunks=True, **stored))
    assert found.startswith(f"hypotheses: 'hypotheses' is stored with HDF5's filter {number}")
    assert found.endswith("use gzip, shuffle, fletcher32 only")


def test_huge_chunks_are_not_read(faults):
    found = faults(edit=replaced("hypotheses", shape=SHAPE, dtype="f8", chunks=(2**20, 5, 3, 3), maxshape=(None,) * 4))
    assert found == "hypotheses: 'hypotheses' has chunks of 360 MiB; at most 256 are read"


@pytest.mark.parametrize(
    ("name", "shape"), [("grid_indices", (2**40,)), ("density_log_probabilities", (2**62,)), ("image_index", (2**50,))]
)
def test_terabytes_that_were_never_written_are_not_read(faults, name, shape, tmp_path):
    found = faults(edit=replaced(name, shape=shape, dtype="i4" if "ind" in name else "f4", chunks=(1024,)))
    assert f"'{name}' of shape {shape} holds " in found
    assert "most of it was never written" in found
    assert (tmp_path / "preds.h5").stat().st_size < 2**17


NAMES = {
    b"\xff\xfe": r"'\\xff\\xfe'",
    "\x1b[2J\r": r"'\x1b[2J\r'",
    "\u202edlrow": r"'\u202edlrow'",
    "hypothèses": "'hypothèses'",
    "hypotheses ": "'hypotheses '",
    "x" * 60000: "'" + "x" * 99 + "...",
}


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_odd_names_are_shown_without_what_a_terminal_would_obey(faults, name):
    def put(file):
        file[name] = np.zeros(3)
        file.attrs[name] = 1

    near = "; 'hypotheses' is" if str(name).startswith("hypoth") else ""
    assert faults(edit=put) == f"the file: {NAMES[name]} is not part of the format{near}"


def test_hdf5s_own_words_are_shown_without_what_a_terminal_would_obey(faults):
    def put(file):
        del file["hypotheses"]
        file["hypotheses"] = h5py.ExternalLink("\x1b[2J\n", "\x07")

    assert r"a link into another file, '\x1b[2J\n'" in faults(edit=put)


# What is no predictions file at all


@pytest.fixture
def refused(tmp_path, data):
    """Write bytes to a file and return why it is refused."""

    def why(content):
        (tmp_path / "preds.h5").write_bytes(content)
        with pytest.raises(PredictionsError) as caught:
            score_file(tmp_path / "preds.h5", data)
        assert all(line.isprintable() for line in str(caught.value).split("\n"))
        return "\n".join(caught.value.faults)

    return why


@pytest.mark.parametrize("content", [b"", b"\0", b"hypotheses,1,2,3\n" * 999, b"\x89HDF\r\n\x1a\n", b"GIF89a" * 99])
def test_what_is_no_hdf5_is_refused_with_hdf5s_words(refused, content):
    assert refused(content).startswith("cannot be read as HDF5: ")


@pytest.mark.parametrize("libver", [("earliest", "v108"), ("latest", "latest")], ids=["old", "new"])
def test_a_truncated_file_is_refused_wherever_it_ends(refused, scores, tmp_path, libver):
    scores(libver=libver)
    whole = (tmp_path / "preds.h5").read_bytes()
    for length in (*range(1, len(whole), len(whole) // 40), len(whole) - 1):
        assert re.search("cannot be read as HDF5|damaged", refused(whole[:length])), length


def test_damage_under_a_checksum_is_named_beside_the_other_faults(faults, tmp_path, data, valid):
    stored = {"chunks": (IMAGES, HYPOTHESES, 3, 3), "fletcher32": True}
    faults(
        {"query_probability": valid[0]["query_probability"] + 2},
        edit=replaced("hypotheses", data=valid[0]["hypotheses"], **stored),
    )
    path = tmp_path / "preds.h5"
    content = path.read_bytes()
    column = valid[0]["hypotheses"].tobytes()
    at = content.rindex(column)
    path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    with pytest.raises(PredictionsError) as caught:
        score_file(path, data)
    checksum, range_ = caught.value.faults
    assert checksum.startswith("the file: 'hypotheses': is damaged: ")
    assert range_.startswith("classifier: 'query_probability' is not in [0, 1]")


def test_a_file_of_another_kind_of_hdf5_says_what_it_lacks(refused, data):
    shard = next((data / "tetX").glob("*.h5"))
    assert refused(shard.read_bytes()).startswith("the file: attribute 'format': expected 'symsol-annot predictions'")
