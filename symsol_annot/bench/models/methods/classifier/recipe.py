"""The recipe of a classifier of rotations."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Literal

from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import LEFT_OUT, TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.system.text.tables import OneOf

_MAX_NEGATIVES, _MAX_MEMBERS, _MAX_FREQUENCIES = 2**20, 4096, 16


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
        members: how many members of an image's set a step learns as right, drawn anew; 1 is the rotation that it was
            drawn at, as in the thesis.
        near_negatives: how many of the K are drawn near candidates, and weighted so that they stand for uniform ones.
        hard_weight: what all hard negatives weigh together; 0 lets each weigh as much as another negative.
        fitted_shift: whether a number is added to the logits with which the validation images have the highest F.
        bias_from_negatives: whether the logit begins at -ln K, which is right of uniform rotations, in place of 0.
        negatives_outside: whether negatives inside the volume of an image's set weigh nothing, as train is annotated.
        negatives_weight: what all negatives but the hard ones weigh together; 0 lets each weigh 1, as in the thesis.
            At 0.25 or less, whatever is in a set is above the threshold in the limit, however large its volume is.
        backbone: of the first stage, by its name.
    """

    negatives: int
    hard_negatives: int = 0
    frequencies: int = 3
    frozen_epochs: int = 4
    start: Literal["imagenet", "random", "best-recall", "best-precision"] = "best-recall"
    members: int = field(default=1, metadata={LEFT_OUT: True})
    near_negatives: int = field(default=0, metadata={LEFT_OUT: True})
    hard_weight: float = field(default=0.0, metadata={LEFT_OUT: True})
    fitted_shift: bool = field(default=False, metadata={LEFT_OUT: True})
    bias_from_negatives: bool = field(default=False, metadata={LEFT_OUT: True})
    negatives_outside: bool = field(default=False, metadata={LEFT_OUT: True})
    negatives_weight: float = field(default=0.0, metadata={LEFT_OUT: True})
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    @property
    def needs_members(self) -> bool:
        """Whether batches have to say which candidates are members of their images' sets."""
        return self.members > 1

    @property
    def needs_rejected_candidates(self) -> bool:
        """Whether batches have to say which candidates their images rule out."""
        return self.hard_negatives > 0

    @property
    def needs_volumes(self) -> bool:
        """Whether batches have to have the volumes of their images' sets."""
        return self.negatives_outside

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
            members=(1, _MAX_MEMBERS),
            near_negatives=(0, self.negatives - self.hard_negatives),
            hard_weight=(0.0, 1e6),
            negatives_weight=(0.0, 1e6),
        )
        if self.fitted_shift and not self.validation_images:
            yield "fitted_shift: is fitted on validation images, and validation_images is 0"
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
