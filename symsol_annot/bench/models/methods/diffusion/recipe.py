"""The recipe of a diffusion on SO(3)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.system.text.tables import OneOf

_MAX_DRAWS, _MAX_FREQUENCIES, _MAX_SAMPLES, _MAX_STEPS = 2**16, 16, 2**14, 2**12


@dataclass(frozen=True, kw_only=True)
class DiffusionRecipe(TrainingKeys):
    """How a score on SO(3) is learnt: from the rotations that images were drawn at, without their sets.

    Attributes:
        draws: noisy rotations per image and step.
        frequencies: F of the positional encoding of rotations; 0 for none.
        samples: rotations that are drawn per image when it is asked.
        steps: of noise that is taken away, from the most to the least.
        start: of the backbone: published weights by their name, or "random".
        backbone: of the first stage, by its name.
    """

    draws: int = 32
    frequencies: int = 5
    samples: int = 128
    steps: int = 40
    start: Literal["imagenet", "random"] = "random"
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from outside(
            self,
            draws=(1, _MAX_DRAWS),
            frequencies=(0, _MAX_FREQUENCIES),
            samples=(1, _MAX_SAMPLES),
            steps=(2, _MAX_STEPS),
        )
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
