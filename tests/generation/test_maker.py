"""What a maker puts into a shard for each image."""

import h5py
import numpy as np
import pytest
from four_shards import SIZE, Opener, small_plan
from made_sets import threads
from numpy_renderer import NumpyRenderer

from symsol_annot.generation.generate import generate
from symsol_annot.sets.dataset import load
from symsol_annot.sets.plan import label_rotation

pytestmark = pytest.mark.usefixtures("_drawn_once")


def test_image_is_drawn_at_its_own_label(undisturbed):
    renderer = NumpyRenderer("tet", SIZE)
    for sample in load(undisturbed)[::7]:
        np.testing.assert_array_equal(sample.rotation, label_rotation(0, "tet", "test", sample.index))
        view = renderer.render(sample.rotation)
        np.testing.assert_array_equal(sample.image, view.rgb)
        np.testing.assert_array_equal(sample.segmentation, view.segmentation)


def test_a_prefix_does_not_depend_on_how_many_images_follow(tmp_path):
    few, many = 20, 150  # also divided into shards in another way
    for count in (few, many):
        generate(small_plan(test=count), tmp_path / str(count), threads(Opener()))
    for small, large in zip(load(tmp_path / str(few)), load(tmp_path / str(many)), strict=False):
        np.testing.assert_array_equal(small.image, large.image)
        np.testing.assert_array_equal(small.segmentation, large.segmentation)
        np.testing.assert_array_equal(small.rotation, large.rotation)


@pytest.mark.parametrize(("annotate", "annotated"), [("test", {"test"}), ("all", {"train", "test"}), ("none", set())])
def test_annotate_decides_which_splits_have_masks(tmp_path, annotate, annotated):
    generate(small_plan(train=2, test=2, annotate=annotate), tmp_path / "tet", threads(Opener()))
    found = set()
    for path in (tmp_path / "tet").glob("*.h5"):
        with h5py.File(path) as file:
            found |= {file.attrs["split"]} if "symmetry_mask" in file else set()
    assert found == annotated
