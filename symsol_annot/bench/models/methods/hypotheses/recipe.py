"""The recipe of a network with M hypotheses per image."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from symsol_annot.bench.models.loss_tables import HypothesisLossKeys
from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import backbone_key, faults_of_start
from symsol_annot.system.text.tables import OneOf


@dataclass(frozen=True, kw_only=True)
class HypothesisRecipe(HypothesisLossKeys):
    """How a HypothesisNetwork is trained (section 5.3): the keys of its loss, and of its first stage.

    Attributes:
        start: of the backbone: published weights by their name, or "random".
        backbone: of the first stage, by its name.
    """

    start: Literal["imagenet", "random"] = "imagenet"
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
