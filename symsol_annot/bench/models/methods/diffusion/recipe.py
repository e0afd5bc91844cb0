"""The recipe of a diffusion on SO(3)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Literal

from symsol_annot.bench.models.methods.diffusion.noise_levels import LEAST_RAD, MOST_RAD
from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import LEFT_OUT, TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.system.text.tables import OneOf

_MAX_DRAWS, _MAX_FREQUENCIES, _MAX_SAMPLES, _MAX_STEPS = 2**16, 16, 2**14, 2**12
_MAX_WAVES = 2**12
_LEAST_SPREAD, _MAX_SPREAD = 0.05, 10.0  # the levels' logarithms are 0.04 apart


@dataclass(frozen=True, kw_only=True)
class DiffusionRecipe(TrainingKeys):
    """How a score on SO(3) is learnt: from the rotations that images were drawn at, without their sets.

    Attributes:
        draws: noisy rotations per image and step.
        noise_median: the deviation in rad that half of the noise lies below, of a log-normal distribution; 0 draws all
            levels alike.
        noise_spread: the standard deviation of the noise's logarithm, where there is a median.
        frequencies: F of the positional encoding of rotations; 0 for none.
        waves: how many random Fourier features encode rotations; 0 for none.
        samples: rotations that are drawn per image when it is asked, of which the density is made.
        hypotheses: how many of them are listed, M.
        steps: of noise that is taken away, from the most to the least.
        start: of the backbone: published weights by their name, or "random".
        backbone: of the first stage, by its name.
    """

    draws: int = 32
    noise_median: float = field(default=0.0, metadata={LEFT_OUT: True})
    noise_spread: float = field(default=1.0, metadata={LEFT_OUT: True})
    frequencies: int = 5
    waves: int = field(default=0, metadata={LEFT_OUT: True})
    samples: int = 128
    hypotheses: int = 30
    steps: int = 40
    start: Literal["imagenet", "random"] = "random"
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from outside(
            self,
            draws=(1, _MAX_DRAWS),
            noise_spread=(_LEAST_SPREAD, _MAX_SPREAD),
            frequencies=(0, _MAX_FREQUENCIES),
            waves=(0, _MAX_WAVES),
            samples=(1, _MAX_SAMPLES),
            steps=(2, _MAX_STEPS),
            hypotheses=(1, self.samples),
        )
        if self.noise_median and not LEAST_RAD <= self.noise_median <= MOST_RAD:
            yield f"noise_median: expected 0, or {LEAST_RAD} to {MOST_RAD} rad, found {self.noise_median}"
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
