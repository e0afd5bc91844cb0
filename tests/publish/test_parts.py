"""A set of an object with parts, published: the parts by name, and the rule by which they are compared."""

import json
import re
import zlib
from functools import partial

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from balls import capped_set
from bundles import assert_all_in_tar_files, assert_all_same, records_in_tar
from made_sets import make_set, threads
from mesh_renderer import MeshRenderer

import symsol_annot
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.publish.about import About
from symsol_annot.publish.figures import from_document, measure_labels, to_document
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan

IDS = "1 bottom, 2 top, 3 front, 4 back, 5 left, 6 right"


@pytest.fixture(scope="module")
def parted(tmp_path_factory):
    """A bundle of the box, which has parts, beside a tetrahedron, which has a marking."""
    folder = tmp_path_factory.mktemp("parted")
    plan = SetPlan(load_object("box"), {"test": 6}, 0, Camera.filling(16), RenderSettings(), "test")
    generate(plan, folder / "data" / "box", threads(partial(MeshRenderer, plan.spec, plan.camera)))
    make_set(folder / "data", "tetX", test=3, size=16)
    publish(sets_in(folder / "data"), folder / "bundle", About(), as_webdataset=True)
    return folder / "bundle"


@pytest.fixture(scope="module")
def samples(parted):
    """The box's images, which do not all show the same parts."""
    samples = symsol_annot.load(parted / "data" / "box", "test")
    shown = samples.labels().part_pixels > 0
    assert shown.shape == (6, 6)
    assert len(np.unique(shown, axis=0)) > 1
    assert samples.labels().symmetry_mask.shape == (6, len(samples.symmetry_group)) == (6, 8)
    return samples


def test_the_card_names_parts_and_their_rule_beside_the_marking(parted):
    card = (parted / "README.md").read_text()
    assert f"grey PNG: 0 background, 1 body, 2 marking; of box {IDS}, exact" in card
    assert "\n- Of box, images are compared part by part instead" in card
    assert "These parts are, of box: top, front, back, left, right." in card


def test_croissant_describes_each_sets_ids_by_its_own_parts(parted):
    records = {record["name"]: record for record in json.loads((parted / "croissant.json").read_text())["recordSet"]}
    described = {field["name"]: field["description"] for record in records.values() for field in record["field"]}
    assert described["box_test/segmentation"] == f"Grey PNG of ids: 0 background, {IDS}."
    assert described["tetX_test/segmentation"] == "Grey PNG of ids: 0 background, 1 body, 2 marking."
    assert "that break the symmetry" in described["box_test/marking_pixels"]
    assert "The marking's visible area" in described["tetX_test/marking_pixels"]


def test_datasets_reads_every_image_of_parts_from_shards_and_parquet(parted, samples, tmp_path, no_network):
    import datasets

    shards = str(parted / "data" / "box" / "test-*.h5")
    rows = datasets.load_dataset("hdf5", data_files=shards, split="train", cache_dir=str(tmp_path))
    with h5py.File(next(iter(sorted((parted / "data" / "box").glob("test-*.h5"))))) as file:
        group = file.attrs["symmetry_group"]
    assert len(rows) == len(samples)
    for row, sample in zip(rows, samples, strict=True):
        for name in ("image", "segmentation", "rotation", "symmetry_mask", "part_pixels"):
            assert np.array_equal(np.array(row[name]), getattr(sample, name)), name
        symmetry_set = np.array(row["rotation"]) @ group[np.array(row["symmetry_mask"])]
        assert np.array_equal(symmetry_set, sample.symmetry_set.members)
    assert_all_same(datasets.load_dataset(str(parted), "box", split="test", cache_dir=str(tmp_path)), samples)


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_croissant_and_webdataset_hold_every_image_of_parts(parted, samples, no_network):
    import mlcroissant

    records = list(mlcroissant.Dataset(jsonld=parted / "croissant.json").records("box_test"))
    rows = [{field.partition("/")[2]: value for field, value in record.items()} for record in records]
    assert_all_same(rows, samples)
    assert_all_in_tar_files(parted / "webdataset" / "box", "test", samples)


def test_torchs_loader_batches_images_of_parts_with_sets_of_any_size(parted, samples):
    torch_data = pytest.importorskip("torch.utils.data")
    from symsol_annot.torch import SymsolDataset

    (batch,) = torch_data.DataLoader(samples, batch_size=8, collate_fn=list)
    assert [sample.symmetry_set.members.tolist() for sample in batch] == [
        sample.symmetry_set.members.tolist() for sample in samples
    ]
    (stacked,) = torch_data.DataLoader(SymsolDataset(parted / "data" / "box", split="test"), batch_size=8)
    assert np.array_equal(stacked["part_pixels"], np.stack([sample.part_pixels for sample in samples]))
    assert np.array_equal(stacked["symmetry_mask"], np.stack([sample.symmetry_mask for sample in samples]))
    assert np.array_equal(stacked["image"], np.stack([sample.image.transpose(2, 0, 1) for sample in samples]))


@pytest.fixture(scope="module")
def round_bundle(tmp_path_factory):
    """A bundle of a ball with a red cap, which some images hide, beside a tetrahedron, whose sets fill no volume."""
    folder = tmp_path_factory.mktemp("round")
    capped_set(folder)
    make_set(folder / "data", "tetX", test=3, size=16)
    publish(sets_in(folder / "data"), folder / "bundle", About(), as_webdataset=True)
    return folder / "bundle"


@pytest.fixture(scope="module")
def round_samples(round_bundle):
    samples = symsol_annot.load(round_bundle / "data" / "thing", "test")
    assert set(samples.labels().volume.tolist()) == {-1, 0}
    return samples


def test_a_balls_mirror_tells_which_volume_each_image_has_and_holds_it_once(round_bundle, round_samples):
    (shard,) = (round_bundle / "parquet" / "thing").glob("test-*.parquet")
    labels = round_samples.labels()
    assert pq.read_table(shard)["volume"].to_pylist() == labels.volume.tolist()
    of_sets = pq.read_table(round_bundle / "parquet" / "symmetry_groups.parquet").to_pylist()
    (bits,), none = ({row["set"]: row["volumes"] for row in of_sets}[name] for name in ("thing", "tetX"))
    assert none == []
    np.testing.assert_array_equal(np.unpackbits(np.frombuffer(zlib.decompress(bits), np.uint8)), labels.volumes[0].mask)
    records = json.loads((round_bundle / "croissant.json").read_text())["recordSet"]
    fields = {field["name"] for record in records for field in record["field"]}
    assert {"thing_test/volume", "symmetry_groups/volumes"} <= fields
    assert "tetX_test/volume" not in fields
    page = (round_bundle / "README.md").read_text()
    assert "of all rotations in" in page
    assert re.search(r"\| thing \| test \| \d+ \| 16x16 \|.*\| all of SO\(3\) \|", page)
    assert re.search(r"\| tetX \| test \| 3 \| 16x16 \|.*\| 12 \| 5 \|", page)


def test_figures_of_a_ball_come_back_from_json_with_the_shares_of_its_volumes(round_bundle, round_samples):
    (published,) = sets_in(round_bundle / "data" / "thing")
    figures = {("thing", "test"): measure_labels(published, "test")}
    labels = round_samples.labels()
    filled = int((labels.volume >= 0).sum())
    assert dict(figures["thing", "test"].statistics.measures) == {labels.volumes[0].measure: filled}
    again = from_document(json.loads(json.dumps(to_document(figures))))
    assert again["thing", "test"].statistics.measures == figures["thing", "test"].statistics.measures
    assert to_document(again) == to_document(figures)


def test_a_balls_tar_files_tell_which_volume_each_image_has_beside_the_masks(round_bundle, round_samples):
    folder = round_bundle / "webdataset" / "thing"
    assert_all_in_tar_files(folder, "test", round_samples)
    (tar,) = folder.glob("test-*.tar")
    labels = [json.loads(record["json"]) for record in records_in_tar(tar)]
    bits = np.load(folder / "volumes.npy")
    assert bits.shape == (1, 294912)
    for told, sample in zip(labels, round_samples, strict=True):
        assert (told["volume"] >= 0) == (sample.volume is not None)
        if sample.volume is not None:
            assert np.array_equal(np.unpackbits(bits[told["volume"]]), sample.volume.mask)
    others = round_bundle / "webdataset" / "tetX"
    assert sorted(path.suffix for path in others.iterdir()) == [".npy", ".tar"]  # the group alone
    assert all("volume" not in json.loads(record["json"]) for record in records_in_tar(next(others.glob("*.tar"))))


def test_datasets_reads_a_balls_shards_as_they_lie(round_bundle, round_samples, tmp_path, no_network):
    import datasets

    shards = str(round_bundle / "data" / "thing" / "test-*.h5")
    rows = datasets.load_dataset("hdf5", data_files=shards, split="train", cache_dir=str(tmp_path))
    with h5py.File(next((round_bundle / "data" / "thing").glob("test-*.h5"))) as file:
        bits = np.frombuffer(zlib.decompress(file.attrs["volumes"].tobytes()), np.uint8).reshape(-1, 294912)
    assert len(rows) == len(round_samples)
    for row, sample in zip(rows, round_samples, strict=True):
        for name in ("image", "segmentation", "rotation", "symmetry_mask", "part_pixels"):
            assert np.array_equal(np.array(row[name]), getattr(sample, name)), name
        assert (row["volume"] >= 0) == (sample.volume is not None)
        if sample.volume is not None:
            assert np.array_equal(np.unpackbits(bits[row["volume"]]), sample.volume.mask)
