"""Mixtures on SO(3) and on axes are densities, sampled as they say, and turned, spread and blurred as they say."""

import math

import numpy as np
import pytest
import torch

from symsol_annot.bench.models.networks.mixtures import AxisMixture, PoseMixture
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.groups import tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations

GRID = torch.from_numpy(equivolumetric_grid(4)).float()


def poses(images=2, components=3, narrower=1.5, seed=0):
    rng = torch.Generator().manual_seed(seed)
    numbers = torch.randn(images, components, 13, generator=rng)
    numbers[..., 6:9] += narrower
    return PoseMixture.from_output(numbers, torch.randn(images, 1, generator=rng))


def axes(images=2, components=3, narrower=1.0, seed=0, *, is_directed=False):
    rng = torch.Generator().manual_seed(seed)
    numbers = torch.randn(images, components, 10, generator=rng)
    numbers[..., 6:8] += narrower
    return AxisMixture.from_output(numbers, torch.randn(images, 1, generator=rng), is_directed=is_directed)


def rotations(count, seed=1):
    return torch.from_numpy(uniform_rotations(count, np.random.default_rng(seed))).float()


def test_the_mean_of_a_concentrated_density_over_all_rotations_is_one():
    """Of components of 4 to 10 degrees; broader ones are off by as much as the normal distribution is."""
    weights = torch.log_softmax(torch.tensor([[0.3, -0.2, 0.1, -1.0]]), 1)
    roots = torch.tensor([[[14.0, 0.0, 0.0], [5.0, 9.0, 0.0], [-3.0, 2.0, 7.0]]]).expand(1, 3, 3, 3)
    pose = PoseMixture(poses(images=1).centres, roots, weights)
    np.testing.assert_allclose(pose.log_density(GRID).exp().mean(1), 1.0, atol=0.02)
    for is_directed in (False, True):
        axis = AxisMixture(axes(images=1).frames, roots[..., :2, :2], weights, is_directed)
        np.testing.assert_allclose(axis.log_density(GRID[:, :, 2]).exp().mean(1), 1.0, atol=0.03)


def test_a_component_is_the_matrix_fisher_distribution_of_its_precision():
    """By the formula of its docstring, one rotation at a time."""
    mixture, R = poses(images=1, components=1), rotations(5)
    H, L = mixture.centres[0, 0].double(), mixture.roots[0, 0].double()
    K = L @ L.T
    A = K.trace() / 2 * torch.eye(3) - K
    scale = 8 * math.pi**2 * (2 * math.pi) ** -1.5 * torch.linalg.det(L)
    weight, uniform = mixture.log_weights[0].double().exp()
    for one, found in zip(R.double(), mixture.log_density(R)[0], strict=True):
        expected = weight * scale * torch.exp(torch.trace(A @ (H.T @ one - torch.eye(3)))) + uniform
        assert float(found) == pytest.approx(math.log(expected), abs=1e-3)


def test_samples_are_where_the_density_is():
    """The mean of 1 / p over samples of p is the volume, 1, where p > 0."""
    rng = torch.Generator().manual_seed(0)
    for mixture in (poses(narrower=3.0), axes(narrower=3.0), axes(narrower=3.0, is_directed=True)):
        drawn = mixture.samples(200_000, rng)
        assert torch.allclose((1 / mixture.log_density(drawn).exp()).mean(1), torch.ones(2), atol=0.15)
        few = mixture.samples(100, torch.Generator().manual_seed(1))
        assert torch.equal(few, mixture.samples(100, torch.Generator().manual_seed(1)))


def test_an_axis_has_no_direction_and_a_direction_has():
    at = rotations(20)[:, :, 2]
    undirected, directed = axes(), axes(is_directed=True)
    assert torch.allclose(undirected.log_density(at), undirected.log_density(-at), atol=1e-5)
    frames = directed.frames[0, :, :, 2]
    assert (directed.log_density(frames)[0] > directed.log_density(-frames)[0] + 1).all()


def test_spread_over_a_group_it_is_the_mean_over_the_groups_turns():
    group, R, mixture = torch.from_numpy(tetrahedral_group()).float(), rotations(30), poses()
    spread = mixture.spread_over(group)
    turned = mixture.log_density((R[:, None] @ group).flatten(0, 1)).reshape(2, 30, 12)
    mean = torch.logsumexp(turned, -1) - math.log(12)
    assert torch.allclose(spread.log_density(R), mean, atol=2e-3)
    assert torch.allclose(spread.log_density(R @ group[5]), spread.log_density(R), atol=2e-3)


def test_blurring_adds_to_the_covariance_and_a_precision_divides_it():
    for mixture in (poses(), axes()):
        before = torch.cholesky_inverse(mixture.roots)
        after = torch.cholesky_inverse(mixture.blurred(0.1).roots)
        assert torch.allclose(after - before, 0.01 * torch.eye(before.shape[-1]).expand_as(before), atol=1e-4)
        assert torch.allclose(torch.cholesky_inverse(mixture.with_precision(4.0).roots), before / 4, rtol=1e-4)


def test_a_row_is_one_images_mixture():
    R = rotations(7)
    for mixture, at in ((poses(), R), (axes(), R[:, :, 0])):
        assert len(mixture) == 2
        assert torch.allclose(mixture.row(1).log_density(at)[0], mixture.log_density(at)[1])


@pytest.mark.parametrize("narrower", [0.0, 3.0])
def test_of_one_image_it_is_the_same_at_many_places_piece_by_piece(narrower):
    pose, axis = poses(images=1, narrower=narrower), axes(images=1, narrower=narrower, is_directed=True)
    R, directions = (
        torch.cat([pose.centres[0], rotations(5000)]),
        torch.cat([axis.frames[0, :, :, 2], rotations(5000)[:, 2]]),
    )
    for mixture, at in ((pose, R), (axis, directions)):
        expected = mixture.log_density(at)[0]
        torch.testing.assert_close(mixture.of_image(at), expected, atol=2e-5, rtol=0)
        assert not mixture.of_image(at).requires_grad
        assert float(expected.max() - expected.min()) > 4.0  # from a peak to next to nothing
