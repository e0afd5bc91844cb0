"""M hypotheses per image: how they are learnt, and how a network predicts them."""

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch, decode_images
from symsol_annot.bench.models.devices import as_memory_allows, training_precision
from symsol_annot.bench.models.loss_tables import EMBEDDED_LOSSES, META_LOSSES
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.networks.answers import all_hypotheses
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork
from symsol_annot.bench.models.validation import Figures, hypothesis_figures
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset
from symsol_annot.sets.shard.labels import Labels

_EVALUATED_AT_ONCE, _PREDICTED_AT_ONCE = 64, 64  # images
_BLOCK = 512  # images decoded at once


class HypothesisLearner:
    """M hypotheses per image, under a meta loss over an embedded loss."""

    def __init__(self, recipe: HypothesisRecipe, model: HypothesisNetwork) -> None:
        self.recipe, self.model = recipe, model
        self._meta, self._embedded = META_LOSSES[recipe.meta_loss], EMBEDDED_LOSSES[recipe.embedded_loss]

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the meta losses (B,)."""
        with training_precision(batch.images, self.recipe.precision):
            embeddings = self.model.first_stage(batch.images)
        hypotheses = self.model.from_embeddings(embeddings.float())  # in 32 bits: 0.1 degrees of 16 would show
        of_each = self._embedded.function(
            hypotheses, batch.R_gt[:, None], **self._embedded.arguments_at(self.recipe, epoch)
        )
        return self._meta.function(of_each, **self._meta.arguments_at(self.recipe, epoch))

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return recall and precision (section 5.2) of images (N, H, W, 3), uint8."""
        hypotheses = all_hypotheses(self.model, images, _EVALUATED_AT_ONCE).astype(np.float64)
        return hypothesis_figures(labels, hypotheses)

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:  # noqa: ARG002
        """Return nothing: hypotheses have nothing to fit."""
        return {}


class HypothesisMethod:
    """How networks of M hypotheses are built, trained and asked."""

    def new_model(self, recipe: HypothesisRecipe, pretrained: str | None, rng: torch.Generator) -> HypothesisNetwork:
        """Return a recipe's network."""
        backbone = BACKBONES[recipe.backbone]
        return HypothesisNetwork(
            recipe.hypotheses, pretrained=pretrained, rng=rng, backbone=backbone, input_size=recipe.input_size
        )

    def learner(
        self,
        recipe: HypothesisRecipe,
        model: HypothesisNetwork,
        symmetry_group: Rotations,  # noqa: ARG002
    ) -> HypothesisLearner:
        """Return what trains a network by its recipe."""
        return HypothesisLearner(recipe, model)

    def write_predictions(
        self,
        model: HypothesisNetwork,
        recipe: HypothesisRecipe,  # noqa: ARG002
        dataset: Dataset,
        path: Path,
        asked: Asked,
    ) -> None:
        """Write the hypotheses of a split's images."""
        hypotheses = _hypotheses_by_index(model, dataset)
        write_hypotheses(path, dataset, hypotheses, method=asked.method, resume=asked.resume)


def _hypotheses_by_index(model: HypothesisNetwork, dataset: Dataset) -> Callable[[int], npt.NDArray[np.float32]]:
    """Return a callable from an image's index to its hypotheses (M, 3, 3); it is quick for one image after another."""

    @lru_cache(maxsize=1)
    def in_block(block: int) -> npt.NDArray[np.float32]:
        images = decode_images(dataset[block * _BLOCK : (block + 1) * _BLOCK]).images
        return as_memory_allows(partial(all_hypotheses, model, images), _PREDICTED_AT_ONCE)

    return lambda i: in_block(i // _BLOCK)[i % _BLOCK]


METHOD = HypothesisMethod()
