"""Checking a set's maps on disk: segmentation by the object's parts, and depth."""

import json

import numpy as np
import pytest
from made_sets import make_set
from tampering import put, tampered

from symsol_annot.sets.dataset import load
from symsol_annot.sets.verify import verify

SECOND = "test-00001-of-00003.h5"


@pytest.mark.parametrize("name", ["tetX", "tet"])
def test_segmentation_has_no_id_beyond_the_objects_parts(tmp_path, name):
    folder = make_set(tmp_path, name, test=4, size=16)
    with tampered(folder, "test-00000-of-00001.h5") as shard:
        shard["segmentation"][1, 0, 0] = 2
    known = ["segmentation: image 1: holds an id outside 0, 1, or no object"] if name == "tet" else []
    assert verify(folder) == [f"test-00000-of-00001.h5: {fault}" for fault in known]


def depths_of(ids):
    """Depths that an object of these ids can have."""
    return np.where(ids > 0, np.float32(3.5), np.float32(0.0))


@pytest.fixture
def deep_set(tmp_path):
    """A set with depth maps."""
    return make_set(tmp_path / "deep", test=20, size=16, depth=True)


def test_set_with_depth_has_no_faults(deep_set):
    assert verify(deep_set) == []
    sample = load(deep_set)[3]
    assert ((sample.depth > 0) == (sample.segmentation > 0)).all()


SPOILT_DEPTHS = {
    "no number": lambda depth: np.where(depth > 0, np.nan, depth),
    "infinite": lambda depth: np.where(depth > 0, np.inf, depth),
    "negative": lambda depth: -depth,
    "background with a depth": lambda depth: depth + np.float32(1e-3),
    "background behind the camera": lambda depth: np.where(depth > 0, depth, np.float32(-1e-3)),
    "object without one": lambda depth: np.where(np.cumsum(depth > 0).reshape(depth.shape) == 1, 0, depth),
}


@pytest.mark.parametrize("case", SPOILT_DEPTHS)
def test_depth_that_is_none_is_found(deep_set, case):
    file = "test-00000-of-00002.h5"
    with tampered(deep_set, file) as shard:
        shard["depth"][7] = SPOILT_DEPTHS[case](shard["depth"][7])
    (fault,) = verify(deep_set)
    assert fault.startswith(f"{file}: depth: image 7: is not finite and above 0 where the segmentation has the object")


def test_depth_that_disagrees_with_the_manifest_is_found(tetX_set, deep_set):
    with tampered(tetX_set, SECOND) as shard:
        put(shard, "depth", depths_of(shard["segmentation"][...]))
    (fault,) = verify(tetX_set)
    assert fault == f"{SECOND}: depth: manifest and shard disagree on whether images have depth maps"
    with tampered(deep_set, "test-00000-of-00002.h5") as shard:
        del shard["depth"]
    assert [fault for fault in verify(deep_set) if "depth: manifest and shard disagree" in fault]


@pytest.mark.parametrize("parts", ['["body"]', '["body", "disc"]', '["body", "marking", "rim"]'])
def test_parts_that_are_not_the_sets_are_found(tetX_set, parts):
    count = len(json.loads(parts))
    with tampered(tetX_set, SECOND) as shard:
        shard.attrs["parts"] = parts
        areas = shard["part_pixels"][...]
        put(shard, "part_pixels", np.pad(areas, [(0, 0), (0, 1)])[:, :count])
    assert f"{SECOND}: attribute 'parts': expected " in "\n".join(verify(tetX_set))
