"""A classifier of rotations: how it learns from right and wrong ones, and how it is asked for predictions."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import training_precision
from symsol_annot.bench.models.loss_tables import CLASSIFICATION
from symsol_annot.bench.models.methods.ahead import looking_ahead
from symsol_annot.bench.models.methods.classifier.negatives import hard_negatives, near_negatives, random_rotations
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.methods.logits import LogitsByIndex
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.networks.answers import RotationScorer, embeddings_of
from symsol_annot.bench.models.networks.backbones import BACKBONES
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.validation import Figures, classifier_figures
from symsol_annot.bench.predictions.counted import counted, grid_inside
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.predictions.tracks.classifier import DEFAULT_FLOOR
from symsol_annot.bench.predictions.writing.listed import write_claims
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_index
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset
from symsol_annot.sets.shard.labels import Labels

_EVALUATED_AT_ONCE = 64  # images
_CLAIM_LOGIT = float(np.log(STANDARD_THRESHOLD / (1.0 - STANDARD_THRESHOLD)))
_SHIFTS = np.linspace(-8.0, 8.0, 65)
_NOWHERE = np.zeros(0, dtype=np.int64)
_NEAR_RAD, _NEAR_CIRCLE_RAD, _FAR_SAMPLE = np.radians(15.0), np.radians(6.0), 8192


class ClassifierLearner:
    """A classifier of rotations, from the one it was drawn at and K wrong ones per image."""

    def __init__(self, recipe: ClassifierRecipe, model: RotationClassifier, symmetry_group: Rotations) -> None:
        self.recipe, self.model = recipe, model
        self._symmetry_group = torch.tensor(symmetry_group, dtype=torch.float32, device=model.device)

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:  # noqa: ARG002
        """Return the losses (B,) of eq. 6.15, K new rotations per image; of several members it takes the mean.

        A set with volume h has K h of the K inside it. They weigh 0 where the recipe says `negatives_outside`. With
        `negatives_weight` w in place of K the loss is least at f = p / (p + w), with p the density of right rotations,
        1 / h inside the volume and 0 outside: as h is 1 at most, f is at least 1 / (1 + w) inside.
        """
        right = self._right(batch, rng)
        wrong, weights = self._wrong(batch, rng)
        with training_precision(batch.images, self.recipe.precision):
            logits = self.model.logits(self.model.first_stage(batch.images), torch.cat([right, wrong], dim=1))
        at_right, at_wrong = logits[:, : right.shape[1]], logits[:, right.shape[1] :]
        if right.shape[1] == 1 and weights is None:
            return CLASSIFICATION.function(at_right[:, 0], at_wrong)
        of_wrong = functional.softplus(at_wrong)
        return functional.softplus(-at_right).mean(1) + (of_wrong if weights is None else weights * of_wrong).sum(1)

    def _right(self, batch: Batch, rng: torch.Generator) -> Tensor:
        """Return rotations (B, P, 3, 3) of the images' sets: R_gt, or members drawn anew."""
        if batch.is_member is None:
            return batch.R_gt[:, None]
        chosen = torch.multinomial(batch.is_member.float(), self.recipe.members, replacement=True, generator=rng)
        return batch.R_gt[:, None] @ self._symmetry_group[chosen]

    def _wrong(self, batch: Batch, rng: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """Return K rotations per image (B, K, 3, 3), and what each weighs (B, K); None where all weigh 1."""
        recipe, images = self.recipe, len(batch.images)
        negatives = random_rotations((images, recipe.negatives - recipe.hard_negatives - recipe.near_negatives), rng)
        weights = None
        if recipe.near_negatives:
            group, near = self._symmetry_group, recipe.near_negatives
            negatives, weights = near_negatives(batch.R_gt, group, negatives, near, rng)
        weights = self._weights_of_volumes(batch, negatives, weights)
        if batch.is_rejected is None:
            return negatives, weights
        rejected = hard_negatives(batch.R_gt, batch.is_rejected, self._symmetry_group, recipe.hard_negatives, rng)
        if recipe.hard_weight:
            before = negatives.new_ones(negatives.shape[:2]) if weights is None else weights
            each = recipe.hard_weight / recipe.hard_negatives
            weights = torch.cat([before, before.new_full((images, recipe.hard_negatives), each)], dim=1)
        elif weights is not None:
            weights = torch.cat([weights, weights.new_ones((images, recipe.hard_negatives))], dim=1)
        return torch.cat([negatives, rejected], dim=1), weights

    def _weights_of_volumes(self, batch: Batch, negatives: Tensor, weights: Tensor | None) -> Tensor | None:
        """Return what negatives (B, k, 3, 3) weigh with `negatives_weight` and `negatives_outside`, given (B, k)."""
        recipe = self.recipe
        if not recipe.negatives_weight and batch.volumes is None:
            return weights
        found = negatives.new_ones(negatives.shape[:2]) if weights is None else weights
        if recipe.negatives_weight:
            found = found * (recipe.negatives_weight / negatives.shape[1])
        return found if batch.volumes is None else found * ~batch.volumes.contain(negatives)

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return the means of recall, precision and F-measure at 0.8 (section 7.2) over images (N, H, W, 3), uint8.

        False positives are counted on the grid of level 4: all that are near a candidate, and a sample of the others.
        """
        return classifier_figures(logits.counts(0.0) for logits in self.validation_logits(images, labels))

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:
        """Return what is added to the logits for the highest F-measure of images (N, H, W, 3), uint8, and that F."""
        if not self.recipe.fitted_shift:
            return {}
        every = list(self.validation_logits(images, labels))
        found = {float(shift): classifier_figures(one.counts(shift) for one in every) for shift in _SHIFTS}
        best = max(found, key=lambda shift: found[shift]["f_measure"])
        return {"logit_shift": best, "f_measure": found[best]["f_measure"]}

    @torch.no_grad()
    def validation_logits(self, images: Tensor, labels: Labels) -> Iterator["ValidationLogits"]:
        """Give the logits of each image at its members, and on the grid."""
        grid, device = grid_index(), self.model.device
        radius = _NEAR_RAD if labels.circles is None else _NEAR_CIRCLE_RAD
        sample = np.random.default_rng(0).choice(len(grid), _FAR_SAMPLE, replace=False)
        shares = self.model.shares(torch.from_numpy(grid.rotations[sample]).float().to(device))
        of_sets, scorer = counted(labels, STANDARD_LEVEL), RotationScorer(self.model)
        for i, embedding in enumerate(embeddings_of(self.model, images, _EVALUATED_AT_ONCE)):
            volume, members = labels.volume_of(i), labels.members(i)
            members = members[of_sets.is_counted[i][labels.symmetry_mask[i]]]
            inside = _NOWHERE if volume is None else grid_inside(volume, STANDARD_LEVEL)
            near = np.setdiff1d(grid.within(labels.candidates(i), radius), inside, assume_unique=True)
            is_far = torch.from_numpy(~np.isin(sample, near) & ~np.isin(sample, inside)).to(device)
            asked = (torch.from_numpy(R).float().to(device) for R in (members, grid.rotations[near]))
            at_members, on_near = (scorer.logits(embedding, self.model.shares(R)) for R in asked)
            on_sample = scorer.logits(embedding, shares)
            on_far, on_inside = on_sample[is_far], on_sample[torch.from_numpy(np.isin(sample, inside)).to(device)]
            far_weight = (len(grid) - len(near) - len(inside)) / max(1, len(on_far))
            yield ValidationLogits(at_members, on_near, on_far, far_weight, on_inside, len(inside))


@dataclass(frozen=True, eq=False)
class ValidationLogits:
    """One image's logits: at its members, on all grid rotations near a candidate, and on a sample of the others.

    Attributes:
        members, near, far: (k,) each.
        far_weight: how many rotations of the grid each of the sample stands for.
        inside: (k,) of those of the sample that are inside the volume of the image's set.
        inside_count: how many rotations of the grid are.
    """

    members: Tensor
    near: Tensor
    far: Tensor
    far_weight: float
    inside: Tensor = field(default_factory=lambda: torch.zeros(0))
    inside_count: int = 0

    def counts(self, shift: float) -> tuple[int, int, int]:
        """Return true positives, false positives on the whole grid, and |S|, with something added to the logits."""
        parts = (self.members, self.near, self.far, self.inside)
        true, near, far, inside = (int((part + shift > _CLAIM_LOGIT).sum()) for part in parts)
        true += round(inside * self.inside_count / max(1, len(self.inside)))
        return true, near + round(far * self.far_weight), len(self.members) + self.inside_count


class ClassifierMethod:
    """How classifiers of rotations are built, trained and asked."""

    def new_model(self, recipe: ClassifierRecipe, pretrained: str | None, rng: torch.Generator) -> RotationClassifier:
        """Return a recipe's classifier."""
        backbone = BACKBONES[recipe.backbone]
        model = RotationClassifier(
            recipe.frequencies, pretrained=pretrained, rng=rng, backbone=backbone, input_size=recipe.input_size
        )
        if recipe.bias_from_negatives:
            torch.nn.init.constant_(model.second_stage.logit.bias, -math.log(recipe.negatives))
        return model

    def learner(
        self, recipe: ClassifierRecipe, model: RotationClassifier, symmetry_group: Rotations
    ) -> ClassifierLearner:
        """Return what trains a classifier by its recipe."""
        return ClassifierLearner(recipe, model, symmetry_group)

    def write_predictions(
        self, model: RotationClassifier, recipe: ClassifierRecipe, dataset: Dataset, path: Path, asked: Asked
    ) -> None:
        """Write the probabilities of queries and grid rotations for a split's images."""
        shift, grid = asked.calibration.get("logit_shift", 0.0), equivolumetric_grid(asked.level)
        logits_of = LogitsByIndex(model, recipe.input_size, dataset, grid, asked)

        def at_queries(i: int, R: Rotations) -> npt.NDArray[np.float32]:
            return _probabilities(logits_of.at(i, R) + shift)

        def on_grid(i: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]:
            found = _probabilities(logits_of.on_grid(i) + shift)
            listed = np.flatnonzero(found > np.float32(DEFAULT_FLOOR))
            return listed, found[listed]

        by, level, resume = asked.method, asked.level, asked.resume
        with looking_ahead(len(dataset)) as ahead:
            write_claims(path, dataset, at_queries, on_grid, method=by, level=level, resume=resume, around=ahead)


def _probabilities(logits: Tensor) -> npt.NDArray[np.float32]:
    found: npt.NDArray[np.float32] = logits.sigmoid().cpu().numpy()
    return found


METHOD = ClassifierMethod()
