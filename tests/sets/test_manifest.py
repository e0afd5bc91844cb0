"""manifest.json: what it says of a set, its fingerprints, and how it differs from another plan's."""

import hashlib
import json
import re
from dataclasses import replace

import h5py
import pytest
from made_manifests import FINISHED, PLANNED, SETTINGS, canonical_sha256, with_entry
from made_sets import make_plan

from symsol_annot.errors import OutputError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import read_manifest, write_manifest


@pytest.mark.parametrize(
    "manifest", [PLANNED, FINISHED, PLANNED.with_finished(FINISHED.shards[1]), replace(FINISHED, format_version=1)]
)
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
    arrays = ("image", "segmentation", "rotation", "marking_pixels", "part_pixels", "symmetry_mask")
    contents = {}
    for split in ("train", "test"):
        contents[split] = []
        for path in sorted(tetX_set.glob(f"{split}-*.h5")):
            digest = hashlib.sha256()
            with h5py.File(path) as file:
                for name in (name for name in arrays if name in file):
                    digest.update(f"{name} {file[name].dtype.str} {file[name].shape}\n".encode())
                    digest.update(file[name][...].tobytes())
                group = file.attrs["symmetry_group"]
                digest.update(f"symmetry_group {group.dtype.str} {group.shape}\n".encode() + group.tobytes())
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
    assert re.fullmatch("render: there {'engine': 'cycles'.*}, asked for {'engine': 'opengl'.*}", found)


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
