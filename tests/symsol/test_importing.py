"""The original SYMSOL as sets of ours: what it says is kept, what it does not say stays unknown, no file is lost."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import symsol_source
from hostile_zips import IMAGE, assert_refused, put, rotations_changed, with_value
from imported_sets import MEMBERS, NAMES, SAME_RAD, angles, everything, imported
from made_sets import make_plan, make_set, threads
from PIL import Image
from symsol_source import COUNTS, npz, png, write_zip

import symsol_annot
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring import scoring
from symsol_annot.errors import DataError, DifferentSetError, NotAnnotatedError, OutputError
from symsol_annot.generation.generate import generate
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.verify import verify


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


def test_what_the_source_does_not_say_is_in_no_file(source):
    _, _, made = source
    manifest = json.loads((made["tetX"].folder / "manifest.json").read_text())
    assert manifest["source"]["convention"] == "unknown"
    unknown = {"object_sha256", "seed", "render", "tolerance_px"}
    assert {name for name, value in manifest.items() if value is None} == unknown
    assert manifest["camera"] == {"distance": None, "focal_px": None, "width": 16, "height": 16}
    with h5py.File(made["tetX"].folder / "test-00000-of-00001.h5") as file:
        assert set(file) == {"image", "rotation"}
        assert np.array_equal(file.attrs["symmetry_group"], np.eye(3)[None])
        names = {"format", "format_version", "object", "split", "first_index", "camera", "versions", "source"}
        assert set(file.attrs) == {*names, "symmetry_group", "symmetry_group_sha256"}
    with h5py.File(made["cyl"].folder / "test-00000-of-00001.h5") as file:
        assert set(file) == {"image", "rotation", "symmetry_mask"}


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


def test_only_the_test_split_may_list_sets(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    files["train/rotations.npz"] = npz({"tet": arrays["tet", "train"][:, :1]})
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert made["tet"].manifest.settings.annotate == "test"
    assert len(symsol_annot.load(made["tet"].folder)[0].symmetry_set) == 12
    assert symsol_annot.load(made["tet"].folder, "train")[0].symmetry_mask is None
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


HOSTILE = {
    "no rotation": (
        rotations_changed(lambda t: with_value(t, 11, t[11] * 1.01)),
        "image 11: its rotation is none: off by 0.03",
    ),
    "not a number": (
        rotations_changed(lambda t: with_value(t, (11, 5, 0, 0), np.nan)),
        "image 11: its list is not R g",
    ),
    "a stretched one": (
        rotations_changed(lambda t: with_value(t, (11, 5), t[11, 5] * 1.01)),
        "image 11: its list is not R g",
    ),
    "mirrored": (rotations_changed(lambda t: t * -1, "train", "test"), "image 0: its rotation is none: off by 2"),
    "another's": (rotations_changed(lambda t: with_value(t, (11, 5), t[12, 5])), "image 11: its list is not R g"),
    "an element lost": (rotations_changed(lambda t: t[:, :11]), "as many rotations per image in both splits"),
    "another size": (put(IMAGE, png(np.zeros((16, 17, 3), np.uint8))), r"shape \(16, 17, 3\), the object's first"),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
