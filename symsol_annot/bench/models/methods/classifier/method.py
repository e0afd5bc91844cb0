"""A classifier of rotations: how it learns from right and wrong ones, and how it is asked for predictions."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import backbone_precision
from symsol_annot.bench.models.loss_tables import CLASSIFICATION
from symsol_annot.bench.models.methods.classifier.negatives import hard_negatives, random_rotations
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.networks.answers import embeddings_of, probabilities
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.validation import Figures, classifier_figures
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.predictions.writing.submission import write_classifier
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_size
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset, Labels

_EVALUATED_AT_ONCE = 64  # images


class ClassifierLearner:
    """A classifier of rotations, from the one it was drawn at and K wrong ones per image."""

    def __init__(self, recipe: ClassifierRecipe, model: RotationClassifier, symmetry_group: Rotations) -> None:
        self.recipe, self.model = recipe, model
        self._symmetry_group = torch.tensor(symmetry_group, dtype=torch.float32, device=model.device)

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the losses (B,) of eq. 6.15, K new rotations per image."""
        with backbone_precision(batch.images, self.recipe.precision):
            embeddings = self.model.first_stage(batch.images)
        asked = torch.cat([batch.R_gt[:, None], self._negatives(batch, rng)], dim=1)
        logits = self.model.logits(embeddings.float(), asked)
        return CLASSIFICATION.function(logits[:, 0], logits[:, 1:])

    def _negatives(self, batch: Batch, rng: torch.Generator) -> Tensor:
        """Return K rotations per image (B, K, 3, 3), of which the recipe says how many are rejected candidates."""
        hard = self.recipe.hard_negatives
        negatives = random_rotations((len(batch.images), self.recipe.negatives - hard), rng)
        if batch.is_rejected is None:
            return negatives
        rejected = hard_negatives(batch.R_gt, batch.is_rejected, self._symmetry_group, hard, rng)
        return torch.cat([negatives, rejected], dim=1)

    @torch.no_grad()
    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return the means of recall, precision and F-measure at 0.8 (section 7.2) over images (N, H, W, 3), uint8.

        False positives are counted on the grid of the recipe's level; of a coarser one than level 4 each stands for
        as many rotations of level 4 as there are to one of its own, a rough estimate of what `score` counts.
        """
        level = self.recipe.evaluation_level
        scale = 8 ** max(0, STANDARD_LEVEL - level)
        grid = torch.from_numpy(equivolumetric_grid(level)).float().to(self.model.device)
        counts = []
        for i, embedding in enumerate(embeddings_of(self.model, images, _EVALUATED_AT_ONCE)):
            members = torch.from_numpy(labels.members(i)).float().to(self.model.device)
            false_positives = self._positives(embedding, grid) * scale
            counts.append((self._positives(embedding, members), false_positives, len(members)))
        return classifier_figures(counts)

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:  # noqa: ARG002
        """Return nothing."""
        return {}

    def _positives(self, embedding: Tensor, R: Tensor) -> int:
        """Return of how many rotations (Q, 3, 3) the model says that they are in the set of an embedded image (E,)."""
        return int((probabilities(self.model, embedding, R) > STANDARD_THRESHOLD).sum())


class ClassifierMethod:
    """How classifiers of rotations are built, trained and asked."""

    def new_model(self, recipe: ClassifierRecipe, pretrained: str | None, rng: torch.Generator) -> RotationClassifier:
        """Return a recipe's classifier."""
        backbone = BACKBONES[recipe.backbone]
        return RotationClassifier(
            recipe.frequencies, pretrained=pretrained, rng=rng, backbone=backbone, input_size=recipe.input_size
        )

    def learner(
        self, recipe: ClassifierRecipe, model: RotationClassifier, symmetry_group: Rotations
    ) -> ClassifierLearner:
        """Return what trains a classifier by its recipe."""
        return ClassifierLearner(recipe, model, symmetry_group)

    def write_predictions(
        self,
        model: RotationClassifier,
        recipe: ClassifierRecipe,  # noqa: ARG002
        dataset: Dataset,
        path: Path,
        asked: Asked,
    ) -> None:
        """Write the probabilities of queries and grid rotations for a split's images."""
        classify, size = _probabilities_by_index(model, dataset), grid_size(asked.level)
        by, level, resume = asked.method, asked.level, asked.resume
        write_classifier(path, dataset, classify, method=by, level=level, batch_size=size, resume=resume)


def _probabilities_by_index(
    model: RotationClassifier, dataset: Dataset
) -> Callable[[int, Rotations], npt.NDArray[np.float32]]:
    """Return a callable from an image's index and rotations (n, 3, 3) to probabilities (n,)."""

    @lru_cache(maxsize=1)
    def embedding_of(i: int) -> Tensor:
        return embeddings_of(model, torch.from_numpy(dataset[i].image)[None], 1)[0]

    def classify(i: int, R: Rotations) -> npt.NDArray[np.float32]:
        on_device = torch.from_numpy(R.astype(np.float32)).to(model.device)
        answers: npt.NDArray[np.float32] = probabilities(model, embedding_of(i), on_device).cpu().numpy()
        return answers

    return classify


METHOD = ClassifierMethod()
