"""The backbones that the first stage may have, in one table: how each is built, and which weights fit it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import nn


@dataclass(frozen=True)
class Backbone:
    """A network from normalised images (B, 3, H, W) to features (B, F).

    Attributes:
        name: in recipes, their key `backbone`.
        prefix: of its weights' names within a first stage, so part of the file format.
        features: F.
        build: returns one with weights of its own drawing, which a model draws again.
        pretrained: published weights that fit it, by the names that a recipe's key `start` may have.
        load_pretrained: gives one the weights of a file, or published ones by their name.
    """

    name: str
    prefix: str
    features: int
    build: "Callable[[], nn.Module]"
    pretrained: Sequence[str]
    load_pretrained: "Callable[[nn.Module, str | Path], None]"


def _build_resnet18() -> "nn.Module":
    from symsol_annot.bench.models.networks.resnet import ResNet18  # noqa: PLC0415 - recipes are read without torch

    return ResNet18()


def _load_resnet18(resnet: "nn.Module", pretrained: "str | Path") -> None:
    from symsol_annot.bench.models.networks.resnet import load_pretrained  # noqa: PLC0415 - as above

    load_pretrained(resnet, pretrained)


RESNET18 = Backbone("resnet18", "resnet", 512, _build_resnet18, ("imagenet",), _load_resnet18)
BACKBONES = {RESNET18.name: RESNET18}
