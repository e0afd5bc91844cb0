"""The samples of the small tetX set: what h5py alone reads, and whether a sample is that."""

import h5py
import numpy as np

from symsol_annot.sets.dataset import Sample

TEST_IMAGES, TRAIN_IMAGES, PER_SHARD = 40, 5, 16
SLICES = [
    slice(None),
    slice(5),
    slice(10, 30),
    slice(15, 17),
    slice(None, None, 7),
    slice(39, 2, -5),
    slice(None, None, -1),
    slice(-3, None),
    slice(20, 10),
    slice(0, 1000),
]


def expected_samples(folder, split="test"):
    """What h5py alone reads from a split's files, in order: the fields of each image by name."""
    samples = []
    for path in sorted(folder.glob(f"{split}-*.h5")):
        with h5py.File(path) as file:
            arrays, group = {name: file[name][...] for name in file}, file.attrs["symmetry_group"]
        rows = range(len(arrays["image"]))
        samples += [{"symmetry_group": group, **{name: values[row] for name, values in arrays.items()}} for row in rows]
    return samples


def assert_is(sample, index, expected):
    """Check each field of a sample against what h5py read."""
    assert isinstance(sample, Sample)
    assert sample.index == index
    for name in ("image", "segmentation", "rotation", "symmetry_group", "part_pixels"):
        found = getattr(sample, name)
        assert found.dtype == expected[name].dtype
        np.testing.assert_array_equal(found, expected[name])
    assert sample.marking_pixels == expected["marking_pixels"]
    if "symmetry_mask" in expected:
        assert sample.symmetry_mask.dtype == bool
        np.testing.assert_array_equal(sample.symmetry_mask, expected["symmetry_mask"])
    else:
        assert sample.symmetry_mask is None


def indices(dataset):
    return [sample.index for sample in dataset]
