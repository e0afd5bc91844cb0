"""The keys that the recipes of all models have, and how their values are checked."""

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from symsol_annot.bench.models.networks.backbones import Backbone
from symsol_annot.system.text.toml import TITLE_RULE, is_title, shown

MAX_EPOCHS = 10_000  # a checkpoint's header holds the figures of each
RANDOM = "random"
BEST_RECALL, BEST_PRECISION = "best-recall", "best-precision"
TRAINED_STARTS = (BEST_RECALL, BEST_PRECISION)  # the first stage of a hypothesis network
LEFT_OUT = "left out at its default"  # when a recipe is written
STEPS, COSINE = "steps", "cosine"  # schedules of the learning rate
AUTO, BFLOAT16, FLOAT32 = "auto", "bfloat16", "float32"  # precisions of the backbone
LEAST_BFLOAT16_SIZE = 17  # pixels: below, torch's CPU gradients of a 3x3 convolution on a 1x1 input are garbage
_MAX_BATCH_SIZE, _MAX_RATES, _MAX_VALIDATION_IMAGES = 2**16, 64, 10_000_000
_LEAST_INPUT, _MAX_INPUT = 8, 4096
_MAX_NORM, _MAX_STATISTICS_IMAGES = 1e6, 2**16
_FIRST = 1e-4  # of an epoch: the first step's rate is not 0
_LAST_SHARE = 0.002  # of the learning rate, at the end of a cosine


@dataclass(frozen=True, kw_only=True)
class TrainingKeys:
    """How long, in which batches and at which learning rates a model is trained.

    An epoch is a number on the recipe's own scale, with a fraction within it: 0.5 is half way through the first.

    Attributes:
        title: the row of the thesis's tables, in words.
        epochs: how many.
        batch_size: images per step; an epoch's last images, if fewer, are left out of it.
        learning_rates: Adam's learning rates, one after another.
        milestones: after how many epochs each but the first begins.
        validation_images: how many images, the last of the train split, are evaluated after each epoch, not learnt.
        input_size: the side in pixels that images are reduced to, by area averages, once; 0 leaves them as they are.
        precision: of training: "bfloat16", "float32", or "auto", bfloat16 where the device computes in it.
        schedule: of the learning rate: "steps", between the milestones, or "cosine", from the one there is to nearly 0.
        warm_up: for how many epochs the learning rate rises from 0, a fraction as a rule.
        clip_norm: the longest gradient of a step, which longer ones are scaled to; 0 leaves them as they are.
        statistics_images: how many train images at once give batch normalisation its means and variances after each
            epoch; 0 keeps the running averages over batches.
        rolls: whether each batch is turned about the camera's axis by 0, 90, 180 and 270 degrees, a quarter of it each.
    """

    title: str
    epochs: int
    batch_size: int
    learning_rates: tuple[float, ...]
    milestones: tuple[int, ...]
    validation_images: int = 500
    input_size: int = field(default=0, metadata={LEFT_OUT: True})
    precision: Literal["auto", "bfloat16", "float32"] = field(default="auto", metadata={LEFT_OUT: True})
    schedule: Literal["steps", "cosine"] = field(default="steps", metadata={LEFT_OUT: True})
    warm_up: float = field(default=0.0, metadata={LEFT_OUT: True})
    clip_norm: float = field(default=0.0, metadata={LEFT_OUT: True})
    rolls: bool = field(default=False, metadata={LEFT_OUT: True})
    statistics_images: int = field(default=0, metadata={LEFT_OUT: True})

    @property
    def needs_members(self) -> bool:
        """Whether batches have to say which candidates are members of their images' sets."""
        return False

    @property
    def needs_rejected_candidates(self) -> bool:
        """Whether batches have to say which candidates their images rule out."""
        return False

    @property
    def needs_volumes(self) -> bool:
        """Whether batches have to have the volumes of their images' sets."""
        return False

    def learning_rate_at(self, epoch: float) -> float:
        """Return Adam's learning rate at an epoch from 0."""
        rate = self.learning_rates[bisect_right(self.milestones, epoch)]
        if self.schedule == COSINE:
            rate *= 0.5 * (1.0 + math.cos(math.pi * epoch / self.epochs)) + _LAST_SHARE
        return rate * min(1.0, (epoch + _FIRST) / self.warm_up) if self.warm_up else rate

    def is_frozen_at(self, epoch: float) -> bool:  # noqa: ARG002 - a model's recipe may tell
        """Tell whether the first stage stays as it is at an epoch."""
        return False

    def figures_at(self, epoch: float) -> dict[str, float]:  # noqa: ARG002
        """Return what else changes during a training, as an epoch's figures tell it, by the names of their columns."""
        return {}

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        if not is_title(self.title):
            yield f"title: expected {TITLE_RULE}, found {shown(self.title)}"
        yield from outside(
            self,
            epochs=(1, MAX_EPOCHS),
            batch_size=(2, _MAX_BATCH_SIZE),
            validation_images=(0, _MAX_VALIDATION_IMAGES),
            warm_up=(0.0, float(self.epochs)),
            clip_norm=(0.0, _MAX_NORM),
            statistics_images=(0, _MAX_STATISTICS_IMAGES),
        )
        if self.input_size and not _LEAST_INPUT <= self.input_size <= _MAX_INPUT:
            yield f"input_size: expected 0, or {_LEAST_INPUT} to {_MAX_INPUT}, found {self.input_size}"
        if self.precision == BFLOAT16 and 0 < self.input_size < LEAST_BFLOAT16_SIZE:
            yield (
                f"precision: bfloat16 takes an input of {LEAST_BFLOAT16_SIZE} pixels or more, found "
                f"{self.input_size}; take float32"
            )
        if self.schedule == COSINE and self.milestones:
            yield f"milestones: a cosine has none, found {shown(list(self.milestones))}"
        if len(self.learning_rates) > _MAX_RATES:
            yield f"learning_rates: expected at most {_MAX_RATES}, found {len(self.learning_rates)}"
        if len(self.learning_rates) != len(self.milestones) + 1:
            drops, rates = len(self.milestones), len(self.learning_rates)
            yield f"learning_rates: expected one more than milestones, which are {drops}, found {rates}"
        if not all(0.0 < rate < math.inf for rate in self.learning_rates):
            yield f"learning_rates: expected numbers above 0, found {shown(list(self.learning_rates))}"
        if sorted(set(self.milestones)) != list(self.milestones):
            yield f"milestones: expected ascending epochs, found {shown(list(self.milestones))}"
        if any(not 0 < epoch < self.epochs for epoch in self.milestones):
            yield f"milestones: expected epochs from 1 to {self.epochs - 1}, found {shown(list(self.milestones))}"


def outside(keys: Any, **ranges: tuple[float, float]) -> Iterator[str]:
    """Say which keys have values outside of their ranges, both ends of which are allowed."""
    for name, (least, most) in ranges.items():
        value = getattr(keys, name)
        if not least <= value <= most:
            yield f"{name}: expected {least} to {most}, found {value}"


def backbone_key(default: Backbone) -> Any:
    """Return the field of the key `backbone`; recipes that were written before it was one stay the same text."""
    return field(default=default.name, metadata={LEFT_OUT: True})


def faults_of_start(start: str, backbone: Backbone) -> Iterator[str]:
    """Say that there are no such weights of a backbone."""
    if start not in (RANDOM, *TRAINED_STARTS, *backbone.pretrained):
        known = ", ".join((*backbone.pretrained, RANDOM))
        yield f"start: expected one of {known} for the backbone {backbone.name}, found {start}"
