"""The recipe of a classifier of rotations."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.bench.predictions.format import MAX_GRID_LEVEL
from symsol_annot.system.text.tables import OneOf

_MAX_NEGATIVES, _MAX_FREQUENCIES = 2**20, 16


@dataclass(frozen=True, kw_only=True)
class ClassifierRecipe(TrainingKeys):
    """How a RotationClassifier is trained (section 7.3).

    Attributes:
        negatives: K, wrong rotations per image and step.
        hard_negatives: how many of them are rejected candidates of the image, not random rotations; not in the thesis.
        frequencies: F of the positional encoding; 0 for none.
        frozen_epochs: for how many epochs the first stage stays as it began.
        start: of the first stage: that of the hypothesis network with the lowest error in recall or in precision, or
            a backbone alone.
        evaluation_level: of the grid on which the validation images are asked.
        backbone: of the first stage, by its name.
    """

    negatives: int
    hard_negatives: int = 0
    frequencies: int = 3
    frozen_epochs: int = 4
    start: Literal["imagenet", "random", "best-recall", "best-precision"] = "best-recall"
    evaluation_level: int = 4
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    @property
    def needs_rejected_candidates(self) -> bool:
        """Whether batches have to say which candidates their images rule out."""
        return self.hard_negatives > 0

    def is_frozen_at(self, epoch: float) -> bool:
        """Tell whether the first stage stays as it began."""
        return epoch < self.frozen_epochs

    def figures_at(self, epoch: float) -> dict[str, float]:
        """Return whether the first stage is frozen, 1 or 0."""
        return {"is_frozen": float(self.is_frozen_at(epoch))}

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from outside(
            self,
            negatives=(1, _MAX_NEGATIVES),
            hard_negatives=(0, self.negatives),
            frequencies=(0, _MAX_FREQUENCIES),
            frozen_epochs=(0, self.epochs - 1),
            evaluation_level=(0, MAX_GRID_LEVEL),
        )
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
