"""What a method is to the training loop and to `predict`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from symsol_annot.bench.models.recipe_keys import FLOAT32

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from symsol_annot.bench.models.batches import Batch
    from symsol_annot.bench.models.networks.reference_model import ReferenceModel
    from symsol_annot.bench.models.validation import Figures
    from symsol_annot.rotations.so3 import Rotations
    from symsol_annot.sets.dataset import Dataset
    from symsol_annot.sets.shard.labels import Labels


BALANCED, COVERING, SUREST = "balanced", "covering", "surest"
HYPOTHESES = (BALANCED, COVERING, SUREST)


@dataclass(frozen=True)
class Asked:
    """How a model is asked about a split.

    Attributes:
        method: what the file says it is by.
        level: of the grid that it is asked on.
        resume: names the model: kept answers of another are refused.
        calibration: what was fitted on validation images, by names.
        products: the precision of the matrix products that score rotations, "float32" or "bfloat16".
        is_compiled: whether torch.compile works on what scores rotations.
        hypotheses: which of a density's are listed, one of `HYPOTHESES`; others than BALANCED are written alone.
    """

    method: str
    level: int
    resume: str
    calibration: Mapping[str, float]
    products: str = FLOAT32
    is_compiled: bool = False
    hypotheses: str = BALANCED


class Learner(Protocol):
    """A model with its recipe, as it is trained."""

    @property
    def model(self) -> ReferenceModel:
        """What is trained."""

    def losses(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:
        """Return the losses (B,) of a batch's images.

        Args:
            batch: on the model's device.
            epoch: on the recipe's scale, with a fraction within it.
            rng: on the model's device.
        """

    def evaluate(self, images: Tensor, labels: Labels) -> Figures:
        """Return figures of validation images (N, H, W, 3), uint8, on any device; the model is left in eval mode."""

    def calibrate(self, images: Tensor, labels: Labels) -> dict[str, float]:
        """Return what is fitted on validation images, by names, and how good it is there; nothing where nothing is."""


class Method(Protocol):
    """How models of one kind are built, trained and asked; a recipe and a model are always of that kind."""

    def new_model(self, recipe: Any, pretrained: str | None, rng: torch.Generator) -> ReferenceModel:
        """Return a recipe's model.

        Args:
            recipe: names the backbone.
            pretrained: weights of the backbone, by name or path; None for a random start.
            rng: draws all other weights.

        Raises:
            WeightsError: the pretrained weights cannot be had.
        """

    def learner(self, recipe: Any, model: Any, symmetry_group: Rotations) -> Learner:
        """Return what trains a model by its recipe, on images of a body with a group (G, 3, 3)."""

    def write_predictions(self, model: Any, recipe: Any, dataset: Dataset, path: Path, asked: Asked) -> None:
        """Write a model's predictions about a split, in float32.

        Args:
            model: on the device that computes.
            recipe: that it was trained by.
            dataset: the whole split.
            path: of the predictions file.
            asked: how.

        Raises:
            ModelError: the device has too little memory.
            NotAnnotatedError: the split has no symmetry sets.
            PredictionsError: the file is there and about something else, or another model's answers are kept beside it.
            OutputError: another process writes it, or it cannot be written.
        """
