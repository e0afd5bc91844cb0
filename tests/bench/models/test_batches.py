"""Batches: images reduced by the mean of what a pixel covers, and turned as a turned object is seen."""

import numpy as np
import pytest
import torch
from numpy_renderer import NumpyRenderer

from symsol_annot.bench.models.batches import Batch, reduced, rolled
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations


def test_a_reduced_pixel_is_the_mean_of_the_pixels_that_it_covers():
    images = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (2, 12, 20, 3), dtype=np.uint8))
    for size in (2, 4):
        found = reduced(images, size)
        down, right = 12 // size, 20 // size
        expected = images.numpy().reshape(2, size, down, size, right, 3).mean(axis=(2, 4)).round()  # halves to even
        assert found.dtype == torch.uint8
        np.testing.assert_array_equal(found, expected)
    assert reduced(images, 0) is images
    square = images[:, :, :12]
    assert reduced(square, 12) is square


@pytest.mark.parametrize("side", [18, 1024])
def test_areas_that_share_pixels_and_large_ones_are_reduced_to_the_mean_as_well(side):
    white = torch.full((1, side, side, 3), 255, dtype=torch.uint8)
    white[:, : side // 2] = 101
    found = reduced(white, 4)
    assert found.shape == (1, 4, 4, 3)
    assert (found[:, :2] == 101).all()
    assert (found[:, 2:] == 255).all()


def test_a_rolled_image_is_what_is_seen_at_its_rolled_rotation():
    """Drawn again by the ray caster: all but edges are the same to the last level."""
    size, renderer = 48, NumpyRenderer("tetX", 48)
    R = uniform_rotations(8, np.random.default_rng(1))
    images = torch.from_numpy(np.stack([renderer.render(one).rgb for one in R]))
    batch = rolled(Batch(images, torch.from_numpy(R).float()))
    for i in range(8):
        expected = rotations_about([0, 0, 1], np.radians(90.0 * (i // 2))) @ R[i]
        np.testing.assert_allclose(batch.R_gt[i], expected, atol=1e-6)
        again = renderer.render(batch.R_gt[i].double().numpy()).rgb
        differing = (np.abs(again.astype(int) - batch.images[i].numpy()).max(axis=-1) > 2).sum()
        assert differing <= 12, i
        unrolled = (np.abs(again.astype(int) - images[i].numpy()).max(axis=-1) > 2).sum()
        assert i < 2 or unrolled > 50  # it was turned at all
    assert size == batch.images.shape[1]


def test_what_is_said_of_candidates_is_kept_and_chosen_with_the_images():
    is_member = torch.eye(4, dtype=torch.bool)
    batch = Batch(torch.zeros((4, 8, 8, 3), dtype=torch.uint8), torch.eye(3).expand(4, 3, 3), None, is_member)
    assert torch.equal(rolled(batch).is_member, is_member)
    assert torch.equal(batch.rows(torch.tensor([2, 0])).is_member, is_member[[2, 0]])
    assert batch.rows(slice(1)).is_rejected is None


@pytest.mark.parametrize("count", [1, 2, 3, 5, 6])
def test_a_batch_that_is_no_multiple_of_four_is_rolled_whole(count):
    images = torch.from_numpy(np.random.default_rng(2).integers(0, 256, (count, 8, 8, 3), dtype=np.uint8))
    found = rolled(Batch(images, torch.eye(3).expand(count, 3, 3)))
    assert len(found.images) == len(found.R_gt) == count
    for before, after, R in zip(images, found.images, found.R_gt, strict=True):
        turns = round(float(torch.atan2(R[1, 0], R[0, 0])) / (np.pi / 2)) % 4
        assert torch.equal(after, torch.rot90(before, -turns, (0, 1)))
