"""A mixture density: how it is learnt, calibrated, and how all three tracks follow from it."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.ahead import looking_ahead
from symsol_annot.bench.models.methods.embedded import BLOCK, embedded_blocks
from symsol_annot.bench.models.methods.method import BALANCED, Asked
from symsol_annot.bench.models.methods.mixture.body import body_for
from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.methods.mixture.claims import CLAIM_LOGIT, Calibration
from symsol_annot.bench.models.methods.mixture.densities import Densities
from symsol_annot.bench.models.methods.mixture.image_density import LEAST_CELL, ImageDensity, Indices
from symsol_annot.bench.models.methods.mixture.learner import MixtureLearner
from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, FREE, GROUP, MARKED_CIRCLE, MixtureRecipe
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.mixture_network import Heads, MixtureNetwork, Told
from symsol_annot.bench.predictions.writing.listed import write_cells, write_claims
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

_AT_ONCE = 256  # images embedded
_DENSITIES_KEPT = 2**13  # of some 30 kB, from track to track

Floats32 = npt.NDArray[np.float32]


def heads_of(recipe: MixtureRecipe) -> Heads:
    """Return which parts the density of a recipe's structure has."""
    return {
        FREE: Heads(poses=recipe.components, tells_set_size=True),
        GROUP: Heads(poses=recipe.components),
        CIRCLE: Heads(axes=recipe.axis_components),
        MARKED_CIRCLE: Heads(poses=recipe.components, axes=recipe.axis_components, tells_marking=True),
    }[recipe.structure]


class MixtureMethod:
    """How mixtures are built, trained and asked."""

    def new_model(self, recipe: MixtureRecipe, pretrained: str | None, rng: torch.Generator) -> MixtureNetwork:
        """Return a recipe's network."""
        backbone = BACKBONES[recipe.backbone]
        return MixtureNetwork(
            heads_of(recipe), pretrained=pretrained, rng=rng, backbone=backbone, input_size=recipe.input_size
        )

    def learner(self, recipe: MixtureRecipe, model: MixtureNetwork, symmetry_group: Rotations) -> MixtureLearner:
        """Return what trains a network by its recipe."""
        return MixtureLearner(recipe, model, symmetry_group)

    def write_predictions(
        self, model: MixtureNetwork, recipe: MixtureRecipe, dataset: Dataset, path: Path, asked: Asked
    ) -> None:
        """Write hypotheses, claims and densities of a split's images, or chosen hypotheses alone."""
        density = _densities_by_index(model, recipe, dataset, Calibration.from_record(asked.calibration))
        grid, by, resume = grid_of(asked.level), asked.method, asked.resume

        def at_queries(i: int, R: Rotations) -> Floats32:
            return _claimed(density(i).log_claim(torch.from_numpy(R).float()))

        def on_grid(i: int) -> tuple[Indices, Floats32]:
            near, log_claim = density(i).claimed_on(grid)
            return near, _claimed(log_claim)

        with torch.no_grad(), looking_ahead(len(dataset)) as ahead:
            write_hypotheses(path, dataset, lambda i: density(i).listed(asked.hypotheses), method=by, resume=resume)
            if asked.hypotheses != BALANCED:
                return
            write_claims(path, dataset, at_queries, on_grid, method=by, level=asked.level, resume=resume, around=ahead)
            write_cells(
                path,
                dataset,
                lambda i: density(i).on_cells(grid).double().numpy(),
                method=by,
                floor=LEAST_CELL,
                level=asked.level,
                resume=resume,
                around=ahead,
            )


def _claimed(log_claim: Tensor) -> Floats32:
    probabilities: Floats32 = torch.sigmoid(log_claim + CLAIM_LOGIT).numpy()
    return probabilities


def _densities_by_index(
    model: MixtureNetwork, recipe: MixtureRecipe, dataset: Dataset, calibration: Calibration
) -> Callable[[int], ImageDensity]:
    """Return a callable from an image's index to its density; it is quick for one image after another."""
    body = body_for(recipe, dataset.symmetry_group, model.device)
    densities = Densities(model, recipe.structure, body, calibration)

    embeddings_in = embedded_blocks(model, dataset, recipe.input_size, _AT_ONCE)

    @lru_cache(maxsize=2)
    def told_of(block: int) -> Told:
        return model.told(embeddings_in(block), is_directed=body.is_directed).cpu()

    @lru_cache(maxsize=_DENSITIES_KEPT)
    def density(i: int) -> ImageDensity:
        return densities.of_image(told_of(i // BLOCK).row(i % BLOCK), i)

    return density


METHOD = MixtureMethod()
