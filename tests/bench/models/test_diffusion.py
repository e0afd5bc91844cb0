"""Diffusion: its noise is Brownian motion on SO(3), its score the slope of that density, its samples what fits it."""

import math
from dataclasses import replace

import h5py
import numpy as np
import pytest
import roma
import torch
from read_predictions import density_rows
from tiny_training import DIFFUSION

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.methods.diffusion import heat_kernel, method
from symsol_annot.bench.models.methods.diffusion.heat_kernel import HeatKernel, kernel, slope
from symsol_annot.bench.models.methods.diffusion.method import (
    METHOD,
    DiffusionLearner,
    reverse_walk,
    smoothed_samples,
)
from symsol_annot.bench.models.methods.diffusion.noise_levels import MOST_RAD, deviations, level_shares
from symsol_annot.bench.models.training.checkpoints import open_checkpoint
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.groups import dihedral_group, icosahedral_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)
ANGLES = np.linspace(0.05, 3.0, 60)


def test_noise_turns_as_far_as_a_brownian_walk():
    heat = HeatKernel(torch.device("cpu"))
    level, xi, _ = heat.draw((400_000,), torch.Generator().manual_seed(0))
    angles = xi.norm(dim=-1).double()
    for chosen in (0, 64, 110, 127):
        sigma = float(heat.sigma[chosen])
        at = angles[level == chosen]
        one = float((1.0 + 2.0 * torch.cos(at)).mean())  # the character of degree 1, whose mean is 3 exp(-sigma^2)
        error = float((2.0 * torch.cos(at)).std()) / math.sqrt(len(at))
        assert one == pytest.approx(3.0 * math.exp(-(sigma**2)), abs=4.0 * error + 2e-3)


def test_levels_are_log_normal_about_their_median():
    shares = level_shares(0.15, 0.6)  # whose ends are 4 spreads away
    logarithms = np.log(deviations())
    mean = shares @ logarithms
    assert math.exp(mean) == pytest.approx(0.15, rel=1e-3)
    assert math.sqrt(shares @ (logarithms - mean) ** 2) == pytest.approx(0.6, rel=1e-3)
    np.testing.assert_allclose(level_shares(0.0, 1.0), 1.0 / 128)
    at_the_end = level_shares(MOST_RAD, 0.05)  # cut off, not heaped up
    assert (at_the_end.argmax(), at_the_end.sum()) == (127, pytest.approx(1.0))
    assert at_the_end[126] > 0.5 * at_the_end[127]


def test_noise_is_drawn_at_the_levels_shares():
    level, _, _ = HeatKernel(torch.device("cpu"), 0.3, 0.5).draw((100, 2000), torch.Generator().manual_seed(3))
    assert level.shape == (100, 2000)
    expected = 200_000 * level_shares(0.3, 0.5)
    found, often = np.bincount(level.flatten(), minlength=128), expected > 20.0
    chi_square = ((found - expected)[often] ** 2 / expected[often]).sum()
    assert chi_square < often.sum() + 5.0 * math.sqrt(2.0 * often.sum())


def test_noise_has_no_favourite_axis():
    _, xi, _ = HeatKernel(torch.device("cpu")).draw((100_000,), torch.Generator().manual_seed(1))
    axes = xi / xi.norm(dim=-1, keepdim=True)
    assert axes.mean(0).abs().max() < 0.01
    assert (axes.T @ axes / len(axes) - torch.eye(3) / 3.0).abs().max() < 0.01


@pytest.mark.parametrize("sigma", [0.3, 0.499, 0.501, 0.9, 2.0])
def test_the_slope_is_that_of_the_densitys_logarithm(sigma):
    angles, step = ANGLES[: np.searchsorted(ANGLES, 6.0 * sigma)], 1e-5
    numerical = (np.log(kernel(angles + step, sigma)) - np.log(kernel(angles - step, sigma))) / (2.0 * step)
    np.testing.assert_allclose(slope(angles, sigma), numerical, rtol=1e-4, atol=1e-5)


def test_the_normal_form_meets_the_series(monkeypatch):
    monkeypatch.setattr(heat_kernel, "_SERIES_FROM_RAD", 0.0)
    near = ANGLES[ANGLES < 2.0]
    series = slope(near, 0.499), kernel(near, 0.499)
    monkeypatch.undo()
    np.testing.assert_allclose(slope(near, 0.499), series[0], atol=1e-4)
    ratio = kernel(near, 0.499) / series[1]
    np.testing.assert_allclose(ratio / ratio[0], 1.0, rtol=1e-6)


def test_what_is_to_be_told_points_back():
    _, xi, wanted = HeatKernel(torch.device("cpu")).draw((5000,), torch.Generator().manual_seed(2))
    small = xi.norm(dim=-1) < 3.0
    along = (xi * wanted).sum(-1)[small]
    assert float((along < 0).float().mean()) > 0.99  # towards where it came from
    assert torch.linalg.cross(xi, wanted).norm(dim=-1).max() < 1e-3


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"noise_median": 0.01}, "noise_median: expected 0, or 0.012 to 2.0 rad, found 0.01"),
        ({"noise_median": -0.1}, "noise_median: expected 0, or 0.012 to 2.0 rad, found -0.1"),
        ({"noise_median": math.nan}, "noise_median: expected 0, or 0.012 to 2.0 rad, found nan"),
        ({"noise_spread": 0.0}, "noise_spread: expected 0.05 to 10.0, found 0.0"),
        ({"hypotheses": 9}, "hypotheses: expected 1 to 8, found 9"),
        ({"waves": 5000}, "waves: expected 0 to 4096, found 5000"),
    ],
)
def test_noise_and_waves_that_make_no_sense_are_refused(keys, said):
    assert list(replace(DIFFUSION, **keys).faults()) == [said]


@torch.no_grad()
@pytest.mark.parametrize("median", [0.0, 0.2])
def test_the_loss_is_the_square_of_what_is_wrong(median):
    recipe = replace(DIFFUSION, noise_median=median, noise_spread=0.5)
    images = torch.randint(0, 256, (3, 16, 16, 3), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    R_gt = torch.from_numpy(uniform_rotations(3, np.random.default_rng(0))).float()
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0)).eval()
    losses = DiffusionLearner(recipe, model).losses(Batch(images, R_gt), 0.0, torch.Generator().manual_seed(5))
    heat = HeatKernel(torch.device("cpu"), median, 0.5)
    level, xi, wanted = heat.draw((3, recipe.draws), torch.Generator().manual_seed(5))
    embeddings = model.first_stage(images)
    for i in range(3):
        found = 0.0
        for j in range(recipe.draws):
            R = R_gt[i] @ roma.rotvec_to_rotmat(xi[i, j])
            told = model.scores(embeddings[i : i + 1], R[None, None], heat.sigma[level[i, j]][None, None])[0, 0]
            found += float((told - wanted[i, j]).square().sum()) / recipe.draws
        assert float(losses[i]) == pytest.approx(found, rel=1e-4)


@pytest.mark.parametrize(("frequencies", "waves"), [(0, 0), (2, 0), (0, 5), (2, 5)])
def test_rotations_are_told_in_the_encodings_that_are_asked(frequencies, waves):
    recipe = replace(DIFFUSION, frequencies=frequencies, waves=waves)
    model = METHOD.new_model(recipe, None, torch.Generator().manual_seed(0))
    R = torch.from_numpy(uniform_rotations(6, np.random.default_rng(0))).float().reshape(2, 3, 3, 3)
    encoded = model._encoded(R)
    assert encoded.shape == (2, 3, 9 + 18 * frequencies + 2 * waves)
    assert model.scores(torch.zeros(2, 256), R, torch.full((2, 3), 0.1)).shape == (2, 3, 3)
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(model._encoded(R), encoded, rtol=0.0, atol=1e-5)


def test_waves_tell_a_body_of_sixty_rotations_sooner_than_octaves():
    group = torch.from_numpy(icosahedral_group()).float()
    kernel_of_noise, left = HeatKernel(torch.device("cpu"), 0.15, 0.3), {}
    for frequencies, waves in ((5, 0), (0, 320)):
        rng = torch.Generator().manual_seed(0)
        recipe = replace(DIFFUSION, frequencies=frequencies, waves=waves)
        model = METHOD.new_model(recipe, None, rng)
        optimiser, image = torch.optim.Adam(model.parameters(), 1e-3), torch.rand(1, 256, generator=rng)
        shares = []
        for _ in range(60):
            level, xi, wanted = kernel_of_noise.draw((1, 512), rng)
            R = group[torch.randint(60, (1, 512), generator=rng)] @ roma.rotvec_to_rotmat(xi)
            wrong = (model.scores(image, R, kernel_of_noise.sigma[level]) - wanted).square().mean()
            optimiser.zero_grad()
            wrong.backward()
            optimiser.step()
            shares.append(float(wrong.detach() / wanted.square().mean()))
        left[waves] = np.mean(shares[-10:])
    assert left[320] < 0.7  # of what answering 0 leaves
    assert left[0] > 0.9


class _KnownScore:
    """The score of noise on the members of a set (k, 3, 3), exactly, in place of a network."""

    def __init__(self, members):
        self._members = members

    def scores(self, embeddings, R, sigma):
        s = float(sigma.flatten()[0])
        xi = roma.rotmat_to_rotvec(R[:, :, None].mT @ self._members)  # from R to each member, seen from R
        angles = xi.norm(dim=-1).double().clamp(1e-4, math.pi - 1e-4)
        flat = angles.numpy().ravel()
        log_f = torch.from_numpy(np.log(np.maximum(kernel(flat, s), 1e-300))).reshape(angles.shape)
        slopes = -torch.from_numpy(slope(flat, s)).reshape(angles.shape)
        weights = torch.softmax(log_f, dim=-1)
        directions = xi.double() / angles[..., None]
        return (s * (weights * slopes)[..., None] * directions).sum(2).float()


@pytest.mark.parametrize("products", ["float32", "bfloat16"])
def test_samples_of_a_known_score_are_members_all_alike(products):
    members = torch.from_numpy(dihedral_group(3)).float()
    drawn = reverse_walk(_KnownScore(members), torch.zeros(4, 1), 300, 40, torch.Generator().manual_seed(0), products)
    assert drawn.dtype == torch.float32
    torch.testing.assert_close(drawn @ drawn.mT, torch.eye(3).expand(drawn.shape), atol=1e-4, rtol=0.0)
    cosines = (torch.einsum("bnij,kij->bnk", drawn, members) - 1.0) / 2.0
    nearest = cosines.max(-1)
    assert float(nearest.values.clamp(max=1.0).acos().quantile(0.99)) < 0.05
    shares = torch.bincount(nearest.indices.flatten(), minlength=6) / nearest.indices.numel()
    assert (shares - 1.0 / 6.0).abs().max() < 4.0 * math.sqrt(5.0 / 36.0 / 1200)


def test_smoothed_samples_are_a_density():
    samples = torch.from_numpy(uniform_rotations(5, np.random.default_rng(0))).float()[None]
    anywhere = torch.from_numpy(equivolumetric_grid(3)).float()
    p = smoothed_samples(samples, 0.2, 0.1).log_density(anywhere)[0].exp()
    assert float(p.mean()) == pytest.approx(1.0, abs=0.03)
    assert float(p.min()) == pytest.approx(0.1, abs=1e-3)


def test_samples_are_drawn_once_for_both_tracks(trained, data, tmp_path, monkeypatch):
    drawn, draw = [], method._drawn
    monkeypatch.setattr(method, "_drawn", lambda *given: (drawn.append(len(given[1])), draw(*given))[1])
    with load(data / "tetX") as test:
        predict(open_checkpoint(trained["diffusion"]), test, tmp_path / "preds.h5", torch.device("cpu"), level=0)
        assert sum(drawn) == len(test)


def test_a_checkpoint_answers_with_its_samples_and_their_density(trained, data, tmp_path):
    checkpoint = open_checkpoint(trained["diffusion"])
    assert set(checkpoint.record.calibration) == {"deviation_rad", "uniform_share", "log_likelihood_at_gt"}
    with load(data / "tetX") as test:
        path = tmp_path / "preds.h5"
        assert predict(checkpoint, test, path, torch.device("cpu"), level=1) == ("hypotheses", "density")
    with h5py.File(path) as file:
        assert file["hypotheses"].shape[1] == DIFFUSION.hypotheses
    _, log_p = density_rows(path)[1]
    assert np.exp(log_p).sum() <= 1.0 + 1e-4
    assert set(score_file(path, data).tracks) == {"hypotheses", "density"}
