"""manifest.json: what it says of a set, and that nobody changes a bit of it unseen."""

import hashlib
import json
import os
import re
from dataclasses import replace

import h5py
import pytest
from made_sets import make_plan

from symsol_annot.errors import DataError, OutputError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import MAX_MANIFEST_BYTES, Manifest, ShardEntry, read_manifest, write_manifest
from symsol_annot.sets.settings import RenderedSettings

SETTINGS = RenderedSettings(
    object="mug",
    object_sha256="ab" * 32,
    seed=7,
    camera=Camera(4.0, 27.9, 16, 16),
    render=RenderSettings(),
    tolerance_px=5.0,
    annotate="test",
)
PLANNED = Manifest(
    SETTINGS,
    (
        ShardEntry("train-00000-of-00001.h5", "train", 0, 5),
        ShardEntry("test-00000-of-00002.h5", "test", 0, 16),
        ShardEntry("test-00001-of-00002.h5", "test", 16, 3),
    ),
)


def finished(entry):
    number = entry.first_index + entry.images
    return replace(entry, bytes=1000 + number, sha256=f"{number:064x}", content_sha256=f"{number + 100:064x}")


FINISHED = replace(PLANNED, shards=tuple(finished(entry) for entry in PLANNED.shards))


def with_entry(number, **changes):
    """The finished manifest with one shard's entry changed."""
    return FINISHED.with_finished(replace(FINISHED.shards[number], **changes))


def canonical_sha256(document):
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def write_sealed(folder, document):
    """Write a manifest whose digest of itself is right, as anyone who edits it can."""
    body = {key: value for key, value in document.items() if key != "manifest_sha256"}
    sealed = {**body, "manifest_sha256": canonical_sha256(body)}
    (folder / "manifest.json").write_text(json.dumps(sealed, indent=1) + "\n")


@pytest.fixture
def document(tmp_path):
    """The JSON of the finished manifest, which lies in tmp_path."""
    write_manifest(tmp_path, FINISHED)
    return json.loads((tmp_path / "manifest.json").read_text())


@pytest.mark.parametrize("manifest", [PLANNED, FINISHED, PLANNED.with_finished(FINISHED.shards[1])])
def test_written_manifest_is_read_back(tmp_path, manifest):
    write_manifest(tmp_path, manifest)
    assert read_manifest(tmp_path) == manifest


def test_same_manifest_gives_the_same_bytes(tmp_path):
    write_manifest(tmp_path, FINISHED)
    first = (tmp_path / "manifest.json").read_bytes()
    write_manifest(tmp_path, read_manifest(tmp_path))
    assert (tmp_path / "manifest.json").read_bytes() == first


def test_manifest_that_cannot_be_written_is_an_error_that_names_it(tmp_path):
    with pytest.raises(OutputError, match=r"absent/manifest\.json"):
        write_manifest(tmp_path / "absent", FINISHED)


def test_json_alone_tells_what_a_set_consists_of(tetX_set):
    document = json.loads((tetX_set / "manifest.json").read_text())
    assert (document["object"], document["seed"], document["annotate"]) == ("tetX", 0, "test")
    assert {name: split["images"] for name, split in document["splits"].items()} == {"train": 5, "test": 40}
    assert {name: split["annotated"] for name, split in document["splits"].items()} == {"train": False, "test": True}
    shards = [shard for split in document["splits"].values() for shard in split["shards"]]
    assert {shard["file"] for shard in shards} == {path.name for path in tetX_set.glob("*.h5")}
    for shard in shards:
        data = (tetX_set / shard["file"]).read_bytes()
        assert (shard["bytes"], shard["sha256"]) == (len(data), hashlib.sha256(data).hexdigest())
        with h5py.File(tetX_set / shard["file"]) as file:
            assert (shard["first_index"], shard["images"]) == (file.attrs["first_index"], len(file["image"]))


def test_fingerprint_follows_from_the_arrays_alone(tetX_set):
    document = json.loads((tetX_set / "manifest.json").read_text())
    arrays = ("image", "segmentation", "rotation", "marking_pixels", "symmetry_mask", "symmetry_group")
    contents = {}
    for split in ("train", "test"):
        contents[split] = []
        for path in sorted(tetX_set.glob(f"{split}-*.h5")):
            digest = hashlib.sha256()
            with h5py.File(path) as file:
                for name in (name for name in arrays if name in file):
                    digest.update(f"{name} {file[name].dtype.str} {file[name].shape}\n".encode())
                    digest.update(file[name][...].tobytes())
                row = [split, int(file.attrs["first_index"]), len(file["image"]), digest.hexdigest()]
            contents[split].append(row)
    made_from = {key: document[key] for key in ("object", "object_sha256", "seed", "camera")}
    whole = canonical_sha256({**made_from, "contents": contents["train"] + contents["test"]})
    assert document["fingerprint"] == whole
    for split, rows in contents.items():
        assert document["splits"][split]["fingerprint"] == canonical_sha256({**made_from, "contents": rows})


def test_fingerprint_is_none_until_the_last_shard_is_finished():
    manifest = PLANNED
    for entry in FINISHED.shards:
        assert not manifest.is_finished
        assert manifest.fingerprint is None
        manifest = manifest.with_finished(entry)
    assert manifest == FINISHED
    assert manifest.is_finished
    assert manifest.fingerprint is not None


def test_split_fingerprint_is_none_until_its_own_split_is_finished():
    half = PLANNED.with_finished(FINISHED.shards[0]).with_finished(FINISHED.shards[1])
    assert half.split_fingerprint("test") is None
    assert half.split_fingerprint("train") == FINISHED.split_fingerprint("train") is not None


def test_split_without_images_has_no_fingerprint():
    assert replace(FINISHED, shards=FINISHED.shards[1:]).split_fingerprint("train") is None


@pytest.mark.parametrize(
    "other",
    [
        with_entry(0, content_sha256="0" * 64),
        with_entry(2, content_sha256="0" * 64),
        with_entry(2, images=4),
        with_entry(2, first_index=17),
        replace(FINISHED, shards=FINISHED.shards[1:]),
        replace(FINISHED, shards=FINISHED.shards[::-1]),
        *[
            replace(FINISHED, settings=replace(SETTINGS, **change))
            for change in (
                {"object": "cup"},
                {"object_sha256": "cd" * 32},
                {"seed": 8},
                {"camera": Camera(4.0, 28.0, 16, 16)},
            )
        ],
    ],
)
def test_fingerprint_depends_on_contents_and_on_what_they_were_made_from(other):
    assert other.fingerprint != FINISHED.fingerprint


def test_fingerprint_does_not_depend_on_the_bytes_of_the_shard_files():
    assert with_entry(1, bytes=1, sha256="0" * 64).fingerprint == FINISHED.fingerprint
    assert with_entry(1, bytes=1, sha256="0" * 64).split_fingerprint("test") == FINISHED.split_fingerprint("test")


def test_split_fingerprint_does_not_depend_on_the_other_split():
    others = [with_entry(0, content_sha256="0" * 64), replace(FINISHED, shards=FINISHED.shards[1:])]
    for other in others:
        assert other.split_fingerprint("test") == FINISHED.split_fingerprint("test")
    assert FINISHED.split_fingerprint("test") != FINISHED.split_fingerprint("train")


@pytest.mark.parametrize(
    ("annotate", "train", "test"), [("all", True, True), ("test", False, True), ("none", False, False)]
)
def test_annotate_tells_which_splits_carry_symmetry_sets(annotate, train, test):
    manifest = replace(FINISHED, settings=replace(SETTINGS, annotate=annotate))
    assert (manifest.is_annotated("train"), manifest.is_annotated("test")) == (train, test)


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
        ('"workbench"', '"cycles"'),
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
        ("format_version", 2, "of format version 2, newer than 1, .* update it"),
        ("format_version", "1", "reads format_version 1, found '1'"),
        ("format_version", None, "reads format_version 1, found None"),
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
    ("render",): [None, [], "workbench", 1, {}, {"engine": "workbench"}],
    ("render", "engine"): ["", "luxcore", None, 1, True, [], {}, ["workbench"]],
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


def test_same_plan_has_no_differences():
    assert make_plan().manifest().differences(make_plan().manifest()) == []


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"seed": 3}, "seed: there 3, asked for 0"),
        ({"annotate": "all"}, "annotate: there 'all', asked for 'test'"),
        ({"train": 7}, "train images: there 7, asked for 0"),
        ({"test": 41}, "test images: there 41, asked for 40"),
        ({"size": 64}, "camera: there {.*'width': 64.*}, asked for {.*'width': 32.*}"),
    ],
)
def test_each_difference_between_plans_is_named_with_both_values(change, line):
    there = make_plan(**change).manifest()
    (found,) = make_plan().manifest().differences(there)
    assert re.fullmatch(line, found)


def test_another_engine_is_named():
    there = replace(make_plan(), settings=RenderSettings("cycles")).manifest()
    (found,) = make_plan().manifest().differences(there)
    assert re.fullmatch("render: there {'engine': 'cycles'.*}, asked for {'engine': 'workbench'.*}", found)


def test_another_object_and_another_version_of_it_are_named():
    spec = make_plan().spec
    other_version = replace(make_plan(), spec=replace(spec, digest="0" * 64)).manifest()
    assert make_plan().manifest().differences(other_version) == [
        f"object_sha256: there {'0' * 64!r}, asked for {spec.digest!r}"
    ]
    other = make_plan().manifest().differences(make_plan("tet").manifest())
    assert "object: there 'tet', asked for 'tetX'" in other


def test_all_differences_are_named_not_the_first():
    there = make_plan(seed=1, train=2, annotate="none", size=64).manifest()
    found = make_plan().manifest().differences(there)
    assert [line.split(":")[0] for line in found] == ["seed", "camera", "annotate", "train images"]


def test_another_division_into_shards_is_a_difference():
    first, second = FINISHED.shards[1:]
    other = replace(FINISHED, shards=(FINISHED.shards[0], replace(first, images=15), replace(second, images=4)))
    assert FINISHED.differences(other) == ["the division into shards"]


def test_finished_and_unfinished_shards_of_one_plan_are_no_difference():
    assert PLANNED.differences(FINISHED) == FINISHED.differences(PLANNED) == []
