"""The recipe of an Implicit-PDF."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.system.text.tables import OneOf

_MAX_QUERIES, _MAX_FREQUENCIES = 2**20, 16


@dataclass(frozen=True, kw_only=True)
class ImplicitPdfRecipe(TrainingKeys):
    """How an Implicit-PDF is trained: from the rotations that images were drawn at, without their sets.

    Attributes:
        queries: rotations per image and step over which the softmax is taken, R_gt and uniform ones.
        frequencies: F of the positional encoding; 0 for none.
        start: of the backbone: published weights by their name, or "random".
        backbone: of the first stage, by its name.
    """

    queries: int = 4096
    frequencies: int = 3
    start: Literal["imagenet", "random"] = "random"
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from outside(self, queries=(2, _MAX_QUERIES), frequencies=(0, _MAX_FREQUENCIES))
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
