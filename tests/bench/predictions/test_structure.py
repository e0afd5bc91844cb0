"""The structure of a predictions file: a wrong attribute or data set is named with what was expected and found."""

import h5py
import numpy as np
import pytest
from changed_predictions import MISSING, SHAPE, linked, replaced

from symsol_annot.bench.predictions.tracks.table import TRACKS


def test_a_committed_type_elsewhere_in_the_file_is_a_fault_of_its_own_name_alone(faults, valid):
    def commit(file):
        file["real"] = np.dtype("f8")
        del file["hypothesis_weights"]
        shape = valid[0]["hypothesis_weights"].shape
        file.create_dataset("hypothesis_weights", shape, file["real"])[...] = valid[0]["hypothesis_weights"]

    assert faults(edit=commit) == "the file: 'real' is not part of the format"


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


def test_a_method_that_is_no_text_is_a_fault(faults):
    def set_bytes(file):
        file.attrs.create("method", b"a\xff", dtype=h5py.string_dtype())

    found = faults(edit=set_bytes)
    rule = "expected 1 to 200 printable characters, not all of them spaces"
    assert found == rf"the file: attribute 'method': {rule}, found 'a\udcff'"


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
