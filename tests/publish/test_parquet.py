"""The Parquet mirror is loaded back with the libraries it is for, and every sample compared with the set's."""

import io

import numpy as np
import pyarrow.parquet as pq
import pytest
from bundles import SPLITS, assert_all_same, assert_whole, snapshot
from PIL import Image

import symsol_annot
from symsol_annot.publish import parquet
from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in


@pytest.mark.parametrize(("name", "split"), SPLITS)
def test_datasets_reads_every_sample_offline(bundle, data, tmp_path, no_network, name, split):
    import datasets

    rows = datasets.load_dataset(str(bundle), name, split=split, cache_dir=str(tmp_path))
    assert rows.features["image"] == rows.features["segmentation"] == datasets.Image()
    assert rows.features["rotation"] == datasets.List(datasets.List(datasets.Value("float64")))
    assert_all_same(rows, symsol_annot.load(data / name, split))


def test_datasets_reads_the_groups_and_lists_every_set_and_split(bundle, data, tmp_path, no_network):
    import datasets

    rows = datasets.load_dataset(str(bundle), "symmetry_groups", split="train", cache_dir=str(tmp_path))
    groups = {row["set"]: np.array(row["symmetry_group"]) for row in rows}
    assert set(groups) == {"cylO", "tet", "tetX"}
    for name, split in SPLITS:
        assert groups[name].tobytes() == symsol_annot.load(data / name, split).symmetry_group.tobytes()
    assert datasets.get_dataset_config_names(str(bundle)) == ["cylO", "tet", "tetX", "symmetry_groups"]
    assert datasets.get_dataset_split_names(str(bundle), "tetX") == ["train", "test"]


def test_pyarrow_alone_reads_every_sample(bundle, data):
    for name, split in SPLITS:
        samples = symsol_annot.load(data / name, split)
        paths = sorted((bundle / "parquet" / name).glob(f"{split}-*.parquet"))
        rows = [row for path in paths for row in pq.read_table(path).to_pylist()]
        for row in rows:
            row |= {key: Image.open(io.BytesIO(row[key]["bytes"])) for key in ("image", "segmentation")}
        assert_all_same(rows, samples)


def test_a_row_group_holds_at_most_a_hundred_images(data, tmp_path):
    """So that a viewer that wants one image fetches little. Sets of so few images have small shards, so one is made."""
    samples = symsol_annot.load(data / "tet", "train")
    (tmp_path / "file.parquet").write_bytes(parquet.samples_to_parquet(samples, {}))
    metadata = pq.ParquetFile(tmp_path / "file.parquet").metadata
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [100, 10]


def test_other_software_makes_the_mirror_again(data, tmp_path, monkeypatch):
    out = tmp_path / "bundle"
    publish(sets_in(data / "tetX"), out, About())
    before = snapshot(out)
    monkeypatch.setattr(parquet, "deflate_version", lambda: "9.9.9")
    publish(sets_in(data / "tetX"), out, About())
    made_again = {name for name, contents in snapshot(out).items() if contents != before[name]}
    assert {name for name in before if name.endswith(".parquet")} < made_again
    assert_whole(out)
