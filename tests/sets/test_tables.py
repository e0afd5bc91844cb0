"""A shard is a table: Hugging Face's `datasets` takes it as it lies, with none of this package's code."""

import os

import h5py
import numpy as np
import pytest
from made_sets import make_set

import symsol_annot

os.environ |= {"HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"}  # read when they are imported
datasets = pytest.importorskip("datasets")


@pytest.fixture(scope="module", params=["tetX", "tet"])
def folder(request, tmp_path_factory):
    """A set with all that a shard can hold, in two shards."""
    return make_set(tmp_path_factory.mktemp("tables"), request.param, test=20, size=16, depth=True)


def test_datasets_reads_every_value_of_a_shard_as_it_lies(folder, tmp_path):
    paths = sorted(str(path) for path in folder.glob("test-*.h5"))
    pattern = str(folder / "test-*.h5")  # as docs/loading.md has it
    rows = datasets.load_dataset("hdf5", data_files=pattern, split="train", cache_dir=str(tmp_path))
    with h5py.File(paths[0]) as first:
        assert set(rows.features) == set(first)
        group = first.attrs["symmetry_group"]
    samples = symsol_annot.load(folder)
    assert len(rows) == len(samples) == 20
    for row, sample in zip(rows, samples, strict=True):
        for name in ("image", "segmentation", "depth", "rotation", "symmetry_mask", "part_pixels"):
            expected = getattr(sample, name)
            found = np.array(row[name])
            assert found.shape == expected.shape, name
            np.testing.assert_array_equal(found.astype(expected.dtype), expected, name)
        assert row["marking_pixels"] == sample.marking_pixels
        symmetry_set = np.array(row["rotation"]) @ group[np.array(row["symmetry_mask"])]
        np.testing.assert_allclose(symmetry_set, sample.symmetry_set, rtol=0, atol=1e-15)


def test_types_and_shapes_are_those_of_the_file(folder, tmp_path):
    path = str(next(iter(sorted(folder.glob("test-*.h5")))))
    features = datasets.load_dataset("hdf5", data_files=path, split="train", cache_dir=str(tmp_path)).features
    order = len(symsol_annot.load(folder).symmetry_group)
    parts = len(symsol_annot.load(folder).parts)
    assert features == datasets.Features(
        {
            "image": datasets.Array3D((16, 16, 3), "uint8"),
            "segmentation": datasets.Array2D((16, 16), "uint8"),
            "depth": datasets.Array2D((16, 16), "float32"),
            "rotation": datasets.Array2D((3, 3), "float64"),
            "marking_pixels": datasets.Value("float32"),
            "part_pixels": datasets.List(datasets.Value("float32"), parts),
            "symmetry_mask": datasets.List(datasets.Value("bool"), order),
        }
    )
