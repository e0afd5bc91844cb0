"""Sets of format version 1 are read for good: by all that reads sets, with all checks, and nothing is written to them.

tests/data/format_1 was made with symsol-annot's last commit that wrote version 1: `render` of cube, cylO and tetX with
real Blender, 32x32 pixels, and `import-symsol` of a small zip. What stands in the files is read here with h5py alone.
"""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import symsol_source
from four_shards import state, unopened
from made_sets import make_set, threads
from tampering import put, reseal, tampered

import symsol_annot
from symsol_annot.bench.scoring.reference import score_row
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.gallery.sources import open_sources
from symsol_annot.generation.generate import generate
from symsol_annot.generation.origin import plan_behind
from symsol_annot.publish.about import About
from symsol_annot.publish.parquet import samples_to_parquet
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.statistics import split_statistics
from symsol_annot.sets.verify import verify
from symsol_annot.symsol.importing import import_symsol

KEPT = Path(__file__).parents[1] / "data" / "format_1"
RENDERED = ("cube", "cylO", "tetX")
FOLDERS = {**{name: f"rendered/{name}" for name in RENDERED}, "tet": "imported/tet"}
PARTS = {"cube": ("body",), "cylO": ("body", "marking"), "tetX": ("body", "marking"), "tet": ()}
FILE = "test-00000-of-00001.h5"
REFUSAL = r"holds a set of format version 1, which is read for good but no longer written, so nothing was touched\. "


@pytest.fixture
def sets(tmp_path):
    """Copies of all the sets, by the object's name."""
    folder = Path(shutil.copytree(KEPT, tmp_path / "sets"))
    return {name: folder / path for name, path in FOLDERS.items()}


@pytest.fixture
def tetX(sets):
    return sets["tetX"]


# Read


@pytest.mark.parametrize("name", FOLDERS)
def test_every_sample_is_what_h5py_alone_reads(name):
    folder = KEPT / FOLDERS[name]
    for split in ("train", "test"):
        if not (paths := sorted(folder.glob(f"{split}-*.h5"))):
            continue
        with h5py.File(paths[0]) as file, symsol_annot.load(folder, split) as dataset:
            assert file.attrs["format_version"] == 1
            assert dataset.parts == PARTS[name]
            assert len(dataset) == len(file["image"])
            for row, sample in enumerate(dataset):
                for column in set(file) - {"symmetry_group"}:
                    np.testing.assert_array_equal(getattr(sample, column), file[column][row])
                np.testing.assert_array_equal(sample.symmetry_group, file["symmetry_group"])
                assert (sample.part_pixels, sample.depth) == (None, None)
                if "symmetry_mask" in file:
                    expected = file["rotation"][row] @ file["symmetry_group"][file["symmetry_mask"][row]]
                    np.testing.assert_allclose(sample.symmetry_set, expected, rtol=0, atol=1e-15)
            if "symmetry_mask" in file:
                assert dataset.labels().part_pixels is None
                np.testing.assert_array_equal(dataset.labels().symmetry_mask, file["symmetry_mask"])


@pytest.mark.parametrize("name", RENDERED)
def test_the_marking_shows_where_its_area_reaches_the_tolerance(name):
    with h5py.File(KEPT / FOLDERS[name] / FILE) as file:
        expected = file["marking_pixels"][...] >= file.attrs["tolerance_px"]
    found = [sample.marking_visible for sample in symsol_annot.load(KEPT / FOLDERS[name])]
    assert found == expected.tolist()
    assert any(found) == (name != "cube")
    assert not all(found)


@pytest.mark.parametrize("name", FOLDERS)
def test_a_manifest_goes_back_to_its_own_bytes(tmp_path, name):
    manifest = read_manifest(KEPT / FOLDERS[name])
    assert manifest.format_version == 1
    write_manifest(tmp_path, manifest)
    assert (tmp_path / "manifest.json").read_bytes() == (KEPT / FOLDERS[name] / "manifest.json").read_bytes()


def test_an_item_for_torch_has_what_the_set_has(tetX):
    torch = pytest.importorskip("symsol_annot.sets.torch")
    expected = {"image", "rotation", "index", "symmetry_mask", "marking_pixels", "marking_visible", "segmentation"}
    assert set(torch.SymsolDataset(tetX, "test", segmentation=True)[0]) == expected
    with pytest.raises(SettingsError, match=r"depth: .* has none"):
        torch.SymsolDataset(tetX, "test", depth=True)


# Checked


@pytest.mark.parametrize("name", FOLDERS)
def test_a_good_set_has_no_faults(name):
    assert verify(KEPT / FOLDERS[name]) == []


def spoilt(name, index, value):
    def spoil(shard):
        values = shard[name][...]
        values[index] = value
        put(shard, name, values)

    return spoil


FAULTS = {
    "no rotation": (spoilt("rotation", 3, 0.0), "rotation: image 3: is no rotation"),
    "no area": (spoilt("marking_pixels", 2, np.nan), "marking_pixels: image 2: is no area"),
    "no group": (spoilt("symmetry_group", 5, np.diag([1.0, -1.0, -1.0])), "symmetry_group: "),
    "set without R_gt": (spoilt("symmetry_mask", (4, 0), False), "symmetry_mask: image 4: the set lacks R_gt"),
    "stray id": (spoilt("segmentation", (6, 0, 0), 3), "segmentation: image 6: holds an id outside 0, 1, 2"),
    "no object": (spoilt("segmentation", 6, 0), "segmentation: image 6: holds an id outside 0, 1, 2, or no object"),
    "another seed": (lambda shard: shard.attrs.modify("seed", 1), "attribute 'seed': expected 0, found 1"),
    "an attribute more": (lambda shard: shard.attrs.create("parts", "[]"), "'parts' is not part of format version 1"),
    "a group's attribute": (
        lambda shard: shard.attrs.create("symmetry_group", shard["symmetry_group"][...]),
        "attribute 'symmetry_group' is not part of format version 1",
    ),
    "areas of parts": (
        lambda shard: put(shard, "part_pixels", np.zeros((8, 2), "f4")),
        "'part_pixels' is not part of the format, version 1",
    ),
    "no group at all": (lambda shard: shard.pop("symmetry_group"), "data set 'symmetry_group' is missing"),
    "a group of another type": (
        lambda shard: put(shard, "symmetry_group", shard["symmetry_group"][...], dtype="f4"),
        "'symmetry_group': expected <f8",
    ),
    "too large a group": (
        lambda shard: put(shard, "symmetry_group", None, shape=(7201, 3, 3), dtype="f8"),
        "'symmetry_group': its shape (7201, 3, 3) is beyond the format's limits",
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_whoever_signed_it_what_breaks_a_law_is_found(tetX, case):
    spoil, words = FAULTS[case]
    with tampered(tetX, FILE) as shard:
        spoil(shard)
    assert read_manifest(tetX).format_version == 1
    assert [fault for fault in verify(tetX) if fault.startswith(f"{FILE}: ") and words in fault]
    if not words.startswith("segmentation"):
        with pytest.raises(DataError, match=FILE):
            symsol_annot.load(tetX)[0]


def test_arrays_that_have_not_their_digest_are_found(tetX):
    reseal(tetX, **{FILE: {"content_sha256": "0" * 64}})
    assert verify(tetX) == [f"{FILE}: its arrays do not have the digest content_sha256 {'0' * 64}"]


@pytest.mark.parametrize("version", [1, 2])
def test_manifest_and_shards_of_two_versions_do_not_go_together_and_one_line_says_so(sets, tmp_path, version):
    folder = sets["cube"] if version == 2 else make_set(tmp_path, "tetX", test=4, size=16)
    write_manifest(folder, replace(read_manifest(folder), format_version=version))
    line = f"expected format version {version}, that of the manifest, found {3 - version}: fetch the whole set again"
    assert verify(folder)[0] == f"{FILE}: {line}"
    assert {fault.partition(": ")[2] for fault in verify(folder)} == {line}
    with pytest.raises(DataError, match=f"{FILE}: is no shard of this set:\n  - {line}$"):
        symsol_annot.load(folder)[0]


@pytest.mark.blender
@pytest.mark.parametrize("name", RENDERED)
def test_its_images_are_drawn_again_as_they_are(sets, here, name):
    before = state(sets[name])
    done = here("verify", sets[name], "--audit", "2")
    assert done.returncode == 0, done.stdout
    assert "whole and consistent" in done.stdout
    assert state(sets[name]) == before


# Used


@pytest.mark.parametrize("name", RENDERED)
def test_the_truth_scores_one(tmp_path, name):
    document = score_row("truth", [symsol_annot.load(KEPT / FOLDERS[name])], tmp_path, 0)
    figures = document["objects"][name]["hypotheses"]["all"]
    assert [
        figures[metric]["value"] for metric in ("accuracy_at_5_deg", "coverage_at_1_deg", "f_measure_at_1_deg")
    ] == [
        1.0,
        1.0,
        1.0,
    ]


def test_everything_that_reads_sets_reads_them_and_touches_nothing(sets, tmp_path, here):
    before = {name: state(folder) for name, folder in sets.items()}
    for name, folder in sets.items():
        lines = here("info", folder).stdout.splitlines()
        assert "format       version 1, which is read for good; 2 is what is written today" in lines
        assert here("plot", "images", folder, "--out", tmp_path / f"{name}.png").returncode == 0
        assert split_statistics(folder, read_manifest(folder), "test").images == len(symsol_annot.load(folder))
    assert len(open_sources(sets["tetX"].parent)) == 3
    queries = here("queries", sets["tetX"], "--out", tmp_path / "queries.h5", "--level", "0")
    assert queries.returncode == 0, queries.stderr
    assert {name: state(folder) for name, folder in sets.items()} == before


def test_they_are_published_as_they_are(sets, tmp_path):
    folder, out = sets["tetX"].parent, tmp_path / "bundle"
    publish(sets_in(folder), out, About())
    for name in RENDERED:
        for path in sets[name].iterdir():
            assert (out / "data" / name / path.name).read_bytes() == path.read_bytes()
    pq = pytest.importorskip("pyarrow.parquet")
    (tmp_path / "one").write_bytes(samples_to_parquet(symsol_annot.load(sets["tetX"]), {}))
    for path in (tmp_path / "one", out / "parquet" / "tetX" / FILE.replace(".h5", ".parquet")):
        assert pq.read_table(path).column("part_pixels").to_pylist() == [None] * 8


# Never written


@pytest.mark.parametrize("name", RENDERED)
@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize("is_damaged", [False, True])
def test_rendering_into_one_is_refused_in_a_line_that_says_what_to_do(sets, name, repair, is_damaged):
    folder = sets[name]
    plan = plan_behind(folder, read_manifest(folder))
    if is_damaged:
        (folder / FILE).write_bytes(b"damaged")
    before = state(folder)
    with pytest.raises(DataError, match=REFUSAL + r"Render it anew into another folder \(--out\)") as refused:
        generate(plan, folder, threads(unopened), repair=repair)
    assert "\n" not in str(refused.value)
    assert str(folder) in str(refused.value)
    assert state(folder) == before


def test_another_plan_is_refused_in_the_same_line(tetX):
    plan = replace(plan_behind(tetX, read_manifest(tetX)), seed=7)
    with pytest.raises(DataError, match=REFUSAL):
        generate(plan, tetX, threads(unopened))


@pytest.mark.parametrize("is_damaged", [False, True])
def test_the_command_that_repairs_refuses_it_and_leaves_it(tetX, here, is_damaged):
    if is_damaged:
        (tetX / FILE).unlink()
    before = state(tetX)
    done = here("verify", tetX, "--repair")
    assert done.returncode == 1
    assert f"{tetX}: holds a set of format version 1, which is read for good" in done.stderr
    assert state(tetX) == before


def test_importing_into_one_is_refused(sets, tmp_path):
    files, _ = symsol_source.content(("tet",), counts={"train": 2, "test": 3})
    path, before = symsol_source.write_zip(tmp_path / "symsol.zip", files), state(sets["tet"])
    with pytest.raises(DataError, match=REFUSAL + "Import it anew"):
        list(import_symsol(path, sets["tet"].parent))
    assert state(sets["tet"]) == before


def test_what_is_rendered_anew_has_the_same_labels_in_version_2(tetX, tmp_path):
    """The numpy renderer draws other pixels, but rotations follow from the plan."""
    from numpy_renderer import NumpyRenderer

    plan = plan_behind(tetX, read_manifest(tetX))
    made = generate(plan, tmp_path / "new", threads(partial(NumpyRenderer, "tetX", 32)))
    assert made.format_version == json.loads((tmp_path / "new" / "manifest.json").read_text())["format_version"] == 2
    old, new = symsol_annot.load(tetX).labels(), symsol_annot.load(tmp_path / "new").labels()
    np.testing.assert_array_equal(old.rotation, new.rotation)
    np.testing.assert_array_equal(old.symmetry_group, new.symmetry_group)
    assert new.part_pixels.shape == (8, 2)
