"""The density of poses on the grid: the mixture's own, but for shares that are left out because they are small."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.rotations.so3 import rotations_about

LEVEL = 3


def poses(narrower, components=6, seed=0):
    rng = torch.Generator().manual_seed(seed)
    numbers = torch.randn(1, components, 13, generator=rng)
    numbers[..., 6:9] += narrower
    return PoseMixture.from_output(numbers, torch.randn(1, 1, generator=rng))


def mixed():
    """Two components of 30 degrees or more among narrow ones."""
    mixture = poses(2.5)
    roots = mixture.roots.clone()
    roots[:, :2] /= 30.0
    return replace(mixture, roots=roots)


@pytest.mark.parametrize(
    "mixture", [poses(0.0), poses(2.5), poses(4.0), mixed()], ids=["broad", "narrow", "sharp", "mixed"]
)
@pytest.mark.parametrize("log_least", [-24.0, -6.0, 2.0])
def test_what_is_left_out_is_less_than_stated(mixture, log_least):
    """Beside 2% of rounding: a precision of 60,000 in 32 bits."""
    grid = grid_of(LEVEL)
    whole = mixture.of_image(grid.rotations).double().exp().numpy()
    found = grid.density(mixture, log_least)
    left_out = mixture.components * np.exp(log_least)
    assert (whole - found < left_out + 0.02 * whole).all()
    assert (found - whole < 0.02 * whole).all()


def test_something_is_left_out_where_it_may_be():
    grid, mixture = grid_of(LEVEL), poses(2.5)
    assert (np.log(grid.density(mixture, 2.0)) < mixture.of_image(grid.rotations).numpy() - 1e-3).any()


def test_without_a_share_that_is_large_enough_the_uniform_component_is_left():
    grid, mixture = grid_of(LEVEL), poses(2.5)
    found = grid.density(mixture, float(mixture.log_peaks.max()) + 1.0)
    np.testing.assert_allclose(found, np.full(len(grid), mixture.log_weights[0, -1].exp()))


def test_what_is_chosen_of_a_mixture_keeps_its_weights():
    mixture, is_kept = poses(1.0), torch.tensor([True, False, True, False, False, True])
    chosen = mixture.chosen(is_kept)
    assert chosen.components == 3
    R = grid_of(1).rotations
    torch.testing.assert_close(chosen.log_shares(R), mixture.log_shares(R)[..., is_kept], atol=1e-3, rtol=0)
    torch.testing.assert_close(chosen.log_weights[:, -1], mixture.log_weights[:, -1])


@pytest.mark.parametrize("mixture", [poses(0.0), mixed()], ids=["broad", "mixed"])
def test_along_the_tilts_of_a_direction_a_share_is_a_cosine(mixture):
    R, t = grid_of(1).rotations[:7], torch.linspace(-4.0, 4.0, 9)
    turn = torch.from_numpy(rotations_about((0, 0, 1), t.double().numpy())).float()
    a, b, c = mixture.along_third_axis(R)
    found = c + a * t.cos()[:, None, None] + b * t.sin()[:, None, None]
    expected = mixture.log_shares((R @ turn[:, None]).flatten(0, 1))[0].reshape(found.shape)
    torch.testing.assert_close(found, expected, atol=0.02, rtol=1e-5)


def test_of_a_mixture_without_components_the_density_is_uniform():
    none = poses(1.0).chosen(torch.zeros(6, dtype=torch.bool))
    np.testing.assert_allclose(grid_of(0).density(none, -24.0), np.full(72, none.log_weights[0, -1].exp()))
