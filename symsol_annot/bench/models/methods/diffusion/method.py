"""Diffusion on SO(3): how its score is learnt, and how rotations of an image are drawn from it.

Noise of many sizes is put on the rotations that images were drawn at, and a network learns to tell the score of what is
left, by denoising score matching (Vincent, 2011; Song and Ermon, NeurIPS 2019), on SO(3) as Leach et al. (2022) and
Hsiao et al. (CVPR 2024) do. An image's rotations are drawn from uniform ones, noise taken away step by step.
"""

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import roma
import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import training_precision
from symsol_annot.bench.models.methods.ahead import looking_ahead
from symsol_annot.bench.models.methods.classifier.negatives import random_rotations
from symsol_annot.bench.models.methods.diffusion.heat_kernel import HeatKernel
from symsol_annot.bench.models.methods.diffusion.noise_levels import LEAST_RAD, MOST_RAD
from symsol_annot.bench.models.methods.diffusion.recipe import DiffusionRecipe
from symsol_annot.bench.models.methods.embedded import BLOCK, embedded_blocks
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.methods.mixture.claims import Calibration
from symsol_annot.bench.models.methods.mixture.image_density import LEAST_CELL, PoseDensity
from symsol_annot.bench.models.networks.answers import embeddings_of, matrix_products
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.bench.models.networks.score_network import ScoreNetwork
from symsol_annot.bench.models.recipe_keys import FLOAT32
from symsol_annot.bench.models.validation import Figures, hypothesis_figures
from symsol_annot.bench.predictions.writing.listed import write_cells
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset
from symsol_annot.sets.shard.labels import Labels

_EVALUATED, _CALIBRATED = 128, 256  # images
_EMBEDDED_AT_ONCE, _SAMPLED_AT_ONCE = 64, 16  # images
_SAMPLES_KEPT = 2**13 // _SAMPLED_AT_ONCE  # of some 150 kB for 16 images, from track to track
_DEVIATIONS_RAD, _UNIFORM_SHARES = np.geomspace(0.01, 0.5, 16), (0.001, 0.003, 0.01, 0.03, 0.1, 0.3)


class DiffusionLearner:
    """A score on SO(3), from the rotations that images were drawn at."""

    def __init__(self, recipe: DiffusionRecipe, model: ScoreNetwork) -> None:
        self.recipe, self.model = recipe, model
        self._kernel = HeatKernel(model.device, recipe.noise_median, recipe.noise_spread)

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the mean square (B,) of what is wrong with sigma times the score, over an image's draws."""
        level, xi, wanted = self._kernel.draw((len(batch.images), self.recipe.draws), rng)
        noisy = batch.R_gt[:, None] @ roma.rotvec_to_rotmat(xi)
        with training_precision(batch.images, self.recipe.precision):
            told = self.model.scores(self.model.first_stage(batch.images), noisy, self._kernel.sigma[level])
        return (told - wanted).square().sum(-1).mean(1)

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return recall and precision (section 5.2) of M samples for each of up to 128 images (N, H, W, 3), uint8."""
        drawn = self._samples(images[:_EVALUATED], self.recipe.hypotheses)
        return hypothesis_figures(labels, drawn)

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:
        """Return the deviation and the uniform share with which smoothed samples make R_gt likeliest, and how likely.

        Args:
            images: (N, H, W, 3), uint8, of which 256 at most are taken.
            labels: whose rotations are taken, their sets are not.
        """
        count = min(len(images), _CALIBRATED)
        drawn = torch.from_numpy(self._samples(images[:count], self.recipe.samples)).float()
        R_gt = torch.from_numpy(labels.rotation[:count]).float()[:, None]
        found = {}
        for deviation in _DEVIATIONS_RAD:
            for share in _UNIFORM_SHARES:
                smoothed = smoothed_samples(drawn, float(deviation), share)
                found[float(deviation), share] = float(smoothed.log_density(R_gt).mean())
        deviation, share = max(found, key=lambda pair: found[pair])
        likelihood = found[deviation, share] - math.log(math.pi**2)
        return {"deviation_rad": deviation, "uniform_share": share, "log_likelihood_at_gt": likelihood}

    def _samples(self, images: Tensor, count: int) -> npt.NDArray[np.float64]:
        embeddings = embeddings_of(self.model, images, _EMBEDDED_AT_ONCE)
        rng = torch.Generator(self.model.device).manual_seed(0)
        return np.concatenate(list(_drawn(self.model, embeddings, count, self.recipe.steps, rng)))


def smoothed_samples(samples: Tensor, deviation_rad: float, uniform_share: float) -> PoseMixture:
    """Return the densities of images: equal isotropic components at samples (B, n, 3, 3), and a uniform one."""
    images, count = samples.shape[:2]
    roots = (torch.eye(3) / deviation_rad).expand(images, count, 3, 3)
    of_each = torch.full((images, count), math.log((1.0 - uniform_share) / count))
    log_weights = torch.cat([of_each, torch.full((images, 1), math.log(uniform_share))], dim=1)
    return PoseMixture(samples, roots, log_weights)


@torch.no_grad()
def _drawn(
    model: ScoreNetwork, embeddings: Tensor, count: int, steps: int, rng: torch.Generator, products: str = FLOAT32
) -> Iterator[npt.NDArray[np.float64]]:
    """Give rotations (b, count, 3, 3), a few images at once, of embeddings (B, E)."""
    for part in torch.split(embeddings, _SAMPLED_AT_ONCE):
        yield reverse_walk(model, part, count, steps, rng, products).cpu().double().numpy()


@torch.no_grad()
def reverse_walk(
    model: ScoreNetwork, embeddings: Tensor, count: int, steps: int, rng: torch.Generator, products: str = FLOAT32
) -> Tensor:
    """Return rotations (B, count, 3, 3) of embedded images (B, E), drawn from uniform ones by ancestral sampling.

    A step from the deviation s to the smaller t turns R by the score times (s^2 - t^2), and puts on noise of the
    deviation t sqrt(1 - t^2 / s^2); the last takes what noise is left. The score's layers multiply in `products`.
    """
    R = random_rotations((len(embeddings), count), rng)
    sigmas = np.geomspace(MOST_RAD, LEAST_RAD, steps)
    for sigma, following in zip(sigmas, [*sigmas[1:], 0.0], strict=True):
        with matrix_products(R.device, products):
            told = model.scores(embeddings, R, torch.full(R.shape[:2], float(sigma), device=R.device))
        turn = told.to(R.dtype) * float((sigma**2 - following**2) / sigma)
        noise = torch.randn(turn.shape, generator=rng, device=R.device)
        R = R @ roma.rotvec_to_rotmat(turn + float(following * np.sqrt(1.0 - (following / sigma) ** 2)) * noise)
    return R


class DiffusionMethod:
    """How diffusions are built, trained and asked."""

    def new_model(self, recipe: DiffusionRecipe, pretrained: str | None, rng: torch.Generator) -> ScoreNetwork:
        """Return a recipe's network."""
        backbone = BACKBONES[recipe.backbone]
        return ScoreNetwork(
            recipe.frequencies,
            recipe.waves,
            pretrained=pretrained,
            rng=rng,
            backbone=backbone,
            input_size=recipe.input_size,
        )

    def learner(
        self,
        recipe: DiffusionRecipe,
        model: ScoreNetwork,
        symmetry_group: Rotations,  # noqa: ARG002 - it is told no symmetries
    ) -> DiffusionLearner:
        """Return what trains a network by its recipe."""
        return DiffusionLearner(recipe, model)

    def write_predictions(
        self, model: ScoreNetwork, recipe: DiffusionRecipe, dataset: Dataset, path: Path, asked: Asked
    ) -> None:
        """Write samples as hypotheses, and their smoothed density on the grid."""
        samples, calibration = _samples_by_index(model, recipe, dataset, asked.products), asked.calibration
        deviation, share = calibration.get("deviation_rad", 0.05), calibration.get("uniform_share", 0.03)
        grid, by, resume = grid_of(asked.level), asked.method, asked.resume

        def cells(i: int) -> npt.NDArray[np.float64]:
            mixture = smoothed_samples(torch.from_numpy(samples(i)).float()[None], deviation, share)
            density = PoseDensity(mixture, 1.0, Calibration(), torch.Generator())
            log_p: npt.NDArray[np.float64] = density.on_cells(grid).double().numpy()
            return log_p

        with torch.no_grad(), looking_ahead(len(dataset)) as ahead:
            write_hypotheses(path, dataset, lambda i: samples(i)[: recipe.hypotheses], method=by, resume=resume)
            write_cells(
                path, dataset, cells, method=by, floor=LEAST_CELL, level=asked.level, resume=resume, around=ahead
            )


def _samples_by_index(
    model: ScoreNetwork, recipe: DiffusionRecipe, dataset: Dataset, products: str
) -> Callable[[int], npt.NDArray[np.float64]]:
    """Return a callable from an image's index to its samples (n, 3, 3); it is quick for one image after another."""
    embeddings_in = embedded_blocks(model, dataset, recipe.input_size, _EMBEDDED_AT_ONCE)

    @lru_cache(maxsize=_SAMPLES_KEPT)
    def samples_in(part: int) -> npt.NDArray[np.float64]:
        block, rest = divmod(part * _SAMPLED_AT_ONCE, BLOCK)
        embeddings = embeddings_in(block)[rest : rest + _SAMPLED_AT_ONCE]
        rng = torch.Generator(model.device).manual_seed(part)
        return next(_drawn(model, embeddings, recipe.samples, recipe.steps, rng, products))

    return lambda i: samples_in(i // _SAMPLED_AT_ONCE)[i % _SAMPLED_AT_ONCE]


METHOD = DiffusionMethod()
