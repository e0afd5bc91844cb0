"""A mixture density: how it is learnt, calibrated, and how all three tracks follow from it."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from symsol_annot.bench.models.methods.embedded import BLOCK, embedded_blocks
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.methods.mixture.body import body_for
from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.methods.mixture.claims import CLAIM_LOGIT, Calibration
from symsol_annot.bench.models.methods.mixture.image_density import LEAST_CELL, Densities, ImageDensity
from symsol_annot.bench.models.methods.mixture.learner import MixtureLearner
from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, FREE, GROUP, MARKED_CIRCLE, MixtureRecipe
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.mixture_network import Heads, MixtureNetwork, Told
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

_AT_ONCE = 256  # images embedded
_LEAST_CLAIM = -30.0  # of the logits of grid rotations that are not looked at


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
        """Write hypotheses, claims and densities of a split's images."""
        density = _densities_by_index(model, recipe, dataset, Calibration.from_record(asked.calibration))
        grid, by, resume = grid_of(asked.level), asked.method, asked.resume

        def classify(i: int, R: Rotations) -> npt.NDArray[np.float32]:
            if not np.array_equal(R, grid.index.rotations):
                logits = density(i).log_claim(torch.from_numpy(R).float())
            else:
                logits = torch.full((len(grid),), _LEAST_CLAIM)
                near, log_claim = density(i).claimed_on(grid)
                logits[near] = log_claim
            probabilities: npt.NDArray[np.float32] = torch.sigmoid(logits + CLAIM_LOGIT).numpy()
            return probabilities

        def cells(i: int, _: Rotations) -> npt.NDArray[np.float32]:
            log_p: npt.NDArray[np.float32] = density(i).on_cells(grid).numpy()
            return log_p

        with torch.no_grad():
            write_hypotheses(path, dataset, lambda i: density(i).hypotheses(), method=by, resume=resume)
            write_classifier(path, dataset, classify, method=by, resume=resume, level=asked.level, batch_size=len(grid))
            write_density(
                path,
                dataset,
                cells,
                method=by,
                floor=LEAST_CELL,
                resume=resume,
                level=asked.level,
                batch_size=len(grid),
            )


def _densities_by_index(
    model: MixtureNetwork, recipe: MixtureRecipe, dataset: Dataset, calibration: Calibration
) -> Callable[[int], ImageDensity]:
    """Return a callable from an image's index to its density; it is quick for one image after another."""
    body = body_for(recipe, dataset.symmetry_group, model.device)
    densities = Densities(model, recipe.structure, body, calibration)

    embeddings_in = embedded_blocks(model, dataset, recipe.input_size, _AT_ONCE)

    @lru_cache(maxsize=1)
    def told_of(block: int) -> Told:
        return model.told(embeddings_in(block), is_directed=body.is_directed).cpu()

    @lru_cache(maxsize=1)
    def density(i: int) -> ImageDensity:
        return densities.of_image(told_of(i // BLOCK).row(i % BLOCK), i)

    return density


METHOD = MixtureMethod()
