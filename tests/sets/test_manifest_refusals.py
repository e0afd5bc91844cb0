"""Nobody changes a bit of manifest.json unseen, and what is no manifest is refused."""

import json
import os
from dataclasses import replace

import pytest
from made_manifests import FINISHED, with_entry, write_sealed

from symsol_annot.errors import DataError
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import MAX_MANIFEST_BYTES, read_manifest, write_manifest


@pytest.fixture
def document(tmp_path):
    """The JSON of the finished manifest, which lies in tmp_path."""
    write_manifest(tmp_path, FINISHED)
    return json.loads((tmp_path / "manifest.json").read_text())


def test_any_flipped_bit_is_an_error(tmp_path):
    write_manifest(tmp_path, FINISHED)
    data = (tmp_path / "manifest.json").read_bytes()
    unseen = []
    with (tmp_path / "manifest.json").open("r+b", buffering=0) as file:
        for bit in range(8 * len(data)):
            byte = bit // 8
            file.seek(byte)
            file.write(bytes([data[byte] ^ 1 << bit % 8]))
            try:
                read_manifest(tmp_path)
                unseen.append(bit)
            except DataError:
                pass
            file.seek(byte)
            file.write(data[byte : byte + 1])
    assert unseen == []
    assert read_manifest(tmp_path) == FINISHED


@pytest.mark.parametrize(
    ("there", "instead"),
    [
        ('"seed": 7', '"seed": 8'),
        ('"seed": 7', '"seed": 7.0'),
        ('"seed": 7,', '"seed": 7, "seed": 7,'),
        ('"seed": 7,', '"seed": 7, "note": "mine",'),
        ('"tolerance_px": 5.0', '"tolerance_px": 4.0'),
        ('"annotate": "test"', '"annotate": "all"'),
        ('"annotated": true', '"annotated": false'),
        ('"images": 19', '"images": 20'),
        ('"bytes": 1005', '"bytes": 1006'),
        ('"first_index": 16', '"first_index": "16"'),
        ('"opengl"', '"cycles"'),
        ('"ab', '"cd'),
        (f'"{5:064x}"', f'"{6:064x}"'),
        (f'"{5:064x}"', "null"),
        ('"splits": {', '"splits": {"validation": {},'),
        ("}\n", "}\n\n"),
        ("\n", "\r\n"),
        ("  ", " "),
    ],
)
def test_edited_manifest_is_refused(tmp_path, there, instead):
    write_manifest(tmp_path, FINISHED)
    path = tmp_path / "manifest.json"
    text = path.read_bytes().decode()
    assert there in text
    path.write_bytes(text.replace(there, instead).encode())
    with pytest.raises(DataError, match=r"manifest\.json: is damaged or was edited.*again"):
        read_manifest(tmp_path)


def test_fingerprint_that_is_not_of_the_shards_is_refused_even_with_a_right_digest(tmp_path, document):
    document["fingerprint"] = "0" * 64
    write_sealed(tmp_path, document)
    with pytest.raises(DataError, match="damaged or was edited"):
        read_manifest(tmp_path)


def test_sealing_is_what_the_package_does(tmp_path, document):
    data = (tmp_path / "manifest.json").read_bytes()
    write_sealed(tmp_path, document)  # else the tests beside this one would refuse for the wrong reason
    assert (tmp_path / "manifest.json").read_bytes() == data


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("format", "another set", "is no manifest of a set"),
        ("format", None, "is no manifest of a set"),
        ("format_version", 3, "of format version 3, newer than 2, .* update it"),
        ("format_version", 0, "reads format_version 1 and 2, found 0"),
        ("format_version", "1", "reads format_version 1 and 2, found '1'"),
        ("format_version", True, "reads format_version 1 and 2, found True"),
        ("format_version", None, "reads format_version 1 and 2, found None"),
    ],
)
def test_another_format_is_refused_by_its_name(tmp_path, document, field, value, words):
    write_sealed(tmp_path, {**document, field: value})
    with pytest.raises(DataError, match=words):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        "../test-00000-of-00002.h5",
        "/tmp/test-00000-of-00002.h5",
        "other/test-00000-of-00002.h5",
        "test-00000-of-00002.h5/../../secret",
        "..\\test-00000-of-00002.h5",
        "test-00000-of-00002.h5\n",
        "train-00000-of-00002.h5",
        "test-0-of-2.h5",
        "manifest.json",
        "..",
        "",
        0,
        None,
    ],
)
def test_name_that_is_not_a_shards_is_refused_even_with_right_digests(tmp_path, document, name):
    document["splits"]["test"]["shards"][0]["file"] = name
    write_sealed(tmp_path, document)
    with pytest.raises(DataError, match="damaged or was edited"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("field", ["annotate", "object", "seed", "camera", "splits", "fingerprint"])
def test_missing_field_is_refused_even_with_a_right_digest(tmp_path, document, field):
    del document[field]
    write_sealed(tmp_path, document)
    with pytest.raises(DataError, match="damaged or was edited"):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    "data",
    [b"", b"{", b"\xff\xfe", b"\x89HDF\r\n\x1a\n", b"9" * 5000, pytest.param(b"[" * 100_000, id="deep")],
)
def test_file_that_is_no_json_is_refused(tmp_path, data):
    (tmp_path / "manifest.json").write_bytes(data)
    with pytest.raises(DataError, match=r"manifest\.json: cannot be read as JSON"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("text", ["[]", "null", "3", '"symsol-annot set"', "{}"])
def test_json_that_is_no_manifest_is_refused(tmp_path, text):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(DataError, match="is no manifest of a set"):
        read_manifest(tmp_path)


def at(document, place):
    """The table or list that a path of names leads to, but for its last name."""
    for name in place[:-1]:
        document = document[name]
    return document


SHARD = ("splits", "test", "shards", 0)
NOT_A_NAME = [
    "",
    "..",
    "../mug",
    "/tmp/mug",
    "a/b",
    "mug\x1b[2J",
    "-mug",
    "x" * 65,
    "mug\n",
    "\uff4dug",
    None,
    3,
    ["mug"],
]
NO_COUNT = [-1, 0, 501, 1.0, True, "1", None, 10**30, [], {}]
NO_DIGEST = ["", "0" * 63, "0" * 65, "G" * 64, "AB" * 32, 0, True, [], "0" * 63 + "\n"]
WRONG = {
    ("object",): NOT_A_NAME,
    ("object_sha256",): [*NO_DIGEST, None],
    ("seed",): [-1, 2**63, 1.0, True, "1", None, 10**400, []],
    ("annotate",): ["train", "", None, 1, True, [], {}],
    ("tolerance_px",): [0.0, -1.0, 5, True, "5", 1e999, [], {}],
    ("camera",): [None, [], "camera", 1, {}, {"width": 16, "height": 16}],
    ("camera", "width"): [0, 15, 2049, 16.0, True, "16", None, 10**30, []],
    ("camera", "height"): [0, -16, 2049, 16.5, True, None, {}],
    ("camera", "distance"): [1.0, 0.0, -4.0, 4, True, "4", None, 1e999, []],
    ("camera", "focal_px"): [0.0, -1.0, 27, None, 1e999, "x"],
    ("camera", "tilt"): [1.0],
    ("render",): [None, [], "opengl", 1, {}, {"engine": "opengl"}],
    ("render", "engine"): ["", "luxcore", None, 1, True, [], {}, ["opengl"]],
    ("render", "samples_per_axis"): [0, 1, 3, 16, 2.0, True, "2", None, [], 10**30],
    ("render", "body_colour"): [
        None,
        1,
        "red",
        [],
        [0.5, 0.5],
        [0.5] * 4,
        [2, 0, 0],
        [-0.1, 0, 0],
        ["0"] * 3,
        [None] * 3,
    ],
    ("render", "marking_colour"): [[True, 0, 0], [[0.5] * 3] * 3, {"r": 1}, [1e999, 0, 0]],
    ("render", "depth"): [False, None, 1, "yes"],
    ("render", "ambient"): [-0.1, 1.1, None, "0", True, [], 1e999],
    ("render", "diffuse"): [2, None, [0.5]],
    ("render", "shadows"): [True],
    ("note",): ["mine"],
    ("source",): [None, {}, "elsewhere"],
    ("splits",): [None, [], "test", 1, {"validation": {}}],
    ("splits", "test"): [None, [], 1],
    ("splits", "test", "shards"): [None, {}, "test", [None], [[]], ["test-00000-of-00001.h5"]],
    ("splits", "test", "images"): NO_COUNT,
    ("splits", "test", "annotated"): [False, 1, None],
    (*SHARD, "images"): NO_COUNT,
    (*SHARD, "first_index"): [1, -1, 0.0, False, "0", None, 10**30],
    (*SHARD, "bytes"): [0, -1, 1.0, True, "1", None, 2**40, 10**30, []],
    (*SHARD, "sha256"): [*NO_DIGEST, None],
    (*SHARD, "content_sha256"): [*NO_DIGEST, None],
    (*SHARD, "split"): ["train"],
    (*SHARD, "note"): ["mine"],
}


@pytest.mark.parametrize("place", WRONG, ids=lambda place: ".".join(map(str, place)))
def test_field_of_a_wrong_type_or_beyond_its_limits_is_refused_even_with_right_digests(tmp_path, document, place):
    taken = []
    for value in WRONG[place]:
        changed = json.loads(json.dumps(document))
        at(changed, place)[place[-1]] = value
        write_sealed(tmp_path, changed)
        try:
            read_manifest(tmp_path)
            taken.append(value)
        except DataError as error:
            assert "damaged or was edited" in str(error)  # noqa: PT017 - which values are taken is what the test tells
    assert taken == []


def test_shards_may_be_as_large_as_their_images_and_no_larger(tmp_path):
    for size, is_taken in ((19 * 16 * 16 * 4 + 2**20, True), (2**27, False)):
        manifest = with_entry(1, bytes=size)
        write_manifest(tmp_path, manifest)
        if is_taken:
            assert read_manifest(tmp_path) == manifest
        else:
            with pytest.raises(DataError, match="damaged or was edited"):
                read_manifest(tmp_path)


def test_shards_with_depth_may_be_larger(tmp_path):
    deep = replace(FINISHED, settings=replace(FINISHED.settings, render=RenderSettings(depth=True)))
    size = 2**23 + 7 * 16 * 16 * 16  # of an image of 7 bytes per pixel
    for manifest, is_taken in ((deep, True), (FINISHED, False)):
        write_manifest(tmp_path, manifest.with_finished(replace(manifest.shards[1], bytes=size)))
        if is_taken:
            assert read_manifest(tmp_path).settings.has_depth
        else:
            with pytest.raises(DataError, match="damaged or was edited"):
                read_manifest(tmp_path)


def test_depth_in_a_set_of_version_1_is_refused_which_had_none(tmp_path):
    deep = replace(FINISHED, settings=replace(FINISHED.settings, render=RenderSettings(depth=True)))
    write_manifest(tmp_path, replace(deep, format_version=1))
    with pytest.raises(DataError, match="damaged or was edited"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_shards_that_do_not_follow_on_are_refused_even_with_right_digests(tmp_path, document, count):
    shards = document["splits"]["test"]["shards"]
    for change in (shards[::-1], shards[1:], shards * count + shards, [shards[0]] * 2):
        changed = json.loads(json.dumps(document))
        changed["splits"]["test"]["shards"] = change
        write_sealed(tmp_path, changed)
        with pytest.raises(DataError, match="damaged or was edited"):
            read_manifest(tmp_path)


@pytest.mark.parametrize("kind", ["pipe", "endless", "folder", "too large"])
def test_what_is_no_file_of_a_manifests_size_is_refused_and_not_waited_for(tmp_path, kind):
    path = tmp_path / "manifest.json"
    {
        "pipe": lambda: os.mkfifo(path),
        "endless": lambda: path.symlink_to("/dev/zero"),
        "folder": path.mkdir,
        "too large": lambda: (path.touch(), os.truncate(path, MAX_MANIFEST_BYTES + 1)),
    }[kind]()
    with pytest.raises(DataError, match=r"manifest\.json: cannot be read: is "):
        read_manifest(tmp_path)
