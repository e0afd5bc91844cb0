"""A model as it is trained: its loss on a batch, and its figures on validation images."""

from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.networks.heads import HypothesisNetwork, RotationClassifier
from symsol_annot.bench.models.networks.losses import (
    classification_loss,
    cyclic_cosine_loss,
    evolving_winner_takes_all,
    geodesic_loss,
    relaxed_winner_takes_all,
    von_mises_loss,
    winner_takes_all,
)
from symsol_annot.bench.models.recipe import ClassifierRecipe, HypothesisRecipe, Recipe
from symsol_annot.bench.models.training.data import Batch
from symsol_annot.bench.models.training.devices import backbone_precision
from symsol_annot.bench.models.training.negatives import hard_negatives, random_rotations
from symsol_annot.bench.models.training.schedules import ScheduledValues
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.scoring import metrics
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Labels

EVALUATED_AT_DEG = 5
_IMAGES_AT_ONCE = 64
_ROTATIONS_AT_ONCE = 2**15
_ROTATIONS_AT_ONCE_ON_CPU = 2**12  # twice as fast as 2^15, which its caches do not hold

Figures = dict[str, float]


class Learner(Protocol):
    """A model with its recipe."""

    @property
    def model(self) -> HypothesisNetwork | RotationClassifier:
        """What is trained."""

    def losses(self, batch: Batch, scheduled: ScheduledValues, rng: torch.Generator) -> Tensor:
        """Return the losses (B,) of a batch's images."""

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return figures of validation images (N, H, W, 3), on any device; the model is left in eval mode."""


class HypothesisLearner:
    """M hypotheses an image, under a meta loss over an embedded loss."""

    def __init__(self, recipe: HypothesisRecipe, model: HypothesisNetwork) -> None:
        self.recipe, self.model = recipe, model

    def losses(self, batch: Batch, scheduled: ScheduledValues, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the meta losses (B,)."""
        with backbone_precision(batch.images.device):
            embeddings = self.model.first_stage(batch.images)
        hypotheses = self.model.from_embeddings(embeddings.float())  # in 32 bits: 0.1 degrees of 16 would show
        embedded = self._embedded_losses(hypotheses, batch.R_gt[:, None], scheduled)
        match self.recipe.meta_loss:
            case "wta":
                return winner_takes_all(embedded)
            case "rwta":
                return relaxed_winner_takes_all(embedded, self.recipe.epsilon)
            case "ewta":
                return evolving_winner_takes_all(embedded, scheduled.winners)

    def _embedded_losses(self, R_p: Tensor, R_gt: Tensor, scheduled: ScheduledValues) -> Tensor:
        match self.recipe.embedded_loss:
            case "cyclic-cosine":
                return cyclic_cosine_loss(R_p, R_gt)
            case "von-mises":
                return von_mises_loss(R_p, R_gt, scheduled.concentration)
            case "geodesic":
                return geodesic_loss(R_p, R_gt)

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return recall and precision (section 5.2), pooled over members and over images as `score` does."""
        hypotheses = all_hypotheses(self.model, images, _IMAGES_AT_ONCE).astype(np.float64)
        both = [
            metrics.recall_and_precision_errors(labels.symmetry_set(i), of_image)
            for i, of_image in enumerate(hypotheses)
        ]
        recall_errors, precision_errors = (np.concatenate(errors) for errors in zip(*both, strict=True))
        near = np.radians([EVALUATED_AT_DEG])
        return {
            "recall_mean_error_rad": metrics.mean_error(recall_errors),
            "precision_mean_error_rad": metrics.mean_error(precision_errors),
            f"coverage_at_{EVALUATED_AT_DEG}_deg": float(metrics.share_within(recall_errors, near)[0]),
            f"accuracy_at_{EVALUATED_AT_DEG}_deg": float(metrics.share_within(precision_errors, near)[0]),
        }


class ClassifierLearner:
    """A classifier of rotations, from the one it was drawn at and K wrong ones an image."""

    def __init__(self, recipe: ClassifierRecipe, model: RotationClassifier, symmetry_group: Tensor) -> None:
        self.recipe, self.model, self._symmetry_group = recipe, model, symmetry_group

    def losses(self, batch: Batch, scheduled: ScheduledValues, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the losses (B,) of eq. 6.15, K new rotations an image."""
        with backbone_precision(batch.images.device):
            embeddings = self.model.first_stage(batch.images)
        asked = torch.cat([batch.R_gt[:, None], self._negatives(batch, rng)], dim=1)
        logits = self.model.logits(embeddings.float(), asked)
        return classification_loss(logits[:, 0], logits[:, 1:])

    def _negatives(self, batch: Batch, rng: torch.Generator) -> Tensor:
        """Return K rotations an image (B, K, 3, 3), of which the recipe says how many are rejected candidates."""
        hard = self.recipe.hard_negatives
        negatives = random_rotations((len(batch.images), self.recipe.negatives - hard), rng)
        if batch.is_rejected is None:
            return negatives
        rejected = hard_negatives(batch.R_gt, batch.is_rejected, self._symmetry_group, hard, rng)
        return torch.cat([negatives, rejected], dim=1)

    @torch.no_grad()
    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return the means over images of recall, precision and F-measure at 0.8 (section 7.2).

        False positives are counted on the grid of the recipe's level; of a coarser one than level 4 each stands for
        as many rotations of level 4 as there are to one of its own, a rough estimate of what `score` counts.
        """
        level = self.recipe.evaluation_level
        scale = 8 ** max(0, STANDARD_LEVEL - level)
        device = self.model.first_stage.channel_mean.device
        grid = torch.from_numpy(equivolumetric_grid(level)).float().to(device)
        embeddings = embedded(self.model, images, _IMAGES_AT_ONCE)
        rows = []
        for i, embedding in enumerate(embeddings):
            members = torch.from_numpy(labels.symmetry_set(i)).float().to(device)
            true_positives = self._positives(embedding, members)
            false_positives = self._positives(embedding, grid) * scale
            rows.append(
                (
                    metrics.recall(true_positives, len(members)),
                    metrics.precision(true_positives, false_positives),
                    metrics.f_measure(true_positives, false_positives, len(members)),
                )
            )
        means = np.mean(rows, axis=0).ravel().tolist()
        return dict(zip(("recall", "precision", "f_measure"), means, strict=True))

    def _positives(self, embedding: Tensor, R: Tensor) -> metrics.Counts:
        """Return of how many rotations the model says that they are in the set: (1,)."""
        count = (probabilities(self.model, embedding, R) > STANDARD_THRESHOLD).sum()
        return np.array([int(count)], dtype=np.int64)


def learner_of(recipe: Recipe, model: HypothesisNetwork | RotationClassifier, symmetry_group: Rotations) -> Learner:
    """Return what trains a model by its recipe, on images of a body with a group (G, 3, 3)."""
    if isinstance(recipe, HypothesisRecipe) and isinstance(model, HypothesisNetwork):
        return HypothesisLearner(recipe, model)
    if isinstance(recipe, ClassifierRecipe) and isinstance(model, RotationClassifier):
        device = model.first_stage.channel_mean.device
        return ClassifierLearner(recipe, model, torch.tensor(symmetry_group, dtype=torch.float32, device=device))
    raise TypeError(f"a {type(model).__name__} is not trained by a {type(recipe).__name__}")


@torch.no_grad()
def all_hypotheses(model: HypothesisNetwork, images: Tensor, batch_size: int) -> npt.NDArray[np.float32]:
    """Return the hypotheses (N, M, 3, 3) of images (N, H, W, 3) on any device, in float32."""
    model.eval()
    device = model.output.weight.device
    return torch.cat([model(part.to(device)).cpu() for part in torch.split(images, batch_size)]).numpy()


@torch.no_grad()
def embedded(model: HypothesisNetwork | RotationClassifier, images: Tensor, batch_size: int) -> Tensor:
    """Return the embeddings (N, E) of images (N, H, W, 3) on any device, on the model's."""
    model.eval()
    device = model.first_stage.channel_mean.device
    return torch.cat([model.first_stage(part.to(device)) for part in torch.split(images, batch_size)])


@torch.no_grad()
def probabilities(model: RotationClassifier, embedding: Tensor, R: Tensor) -> Tensor:
    """Return f(I, R) (Q,) of one embedded image (E,) at rotations (Q, 3, 3)."""
    at_once = _ROTATIONS_AT_ONCE_ON_CPU if embedding.device.type == "cpu" else _ROTATIONS_AT_ONCE
    parts = [model.logits(embedding[None], part)[0] for part in torch.split(R, at_once)]
    return torch.cat(parts).sigmoid()
