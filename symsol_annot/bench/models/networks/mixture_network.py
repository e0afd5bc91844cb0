"""From an image to a mixture density on SO(3), in a form that fits the body."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from symsol_annot.bench.models.networks.backbones import RESNET18, Backbone
from symsol_annot.bench.models.networks.first_stage import EMBEDDING_SIZE
from symsol_annot.bench.models.networks.mixtures import AXIS_NUMBERS, POSE_NUMBERS, AxisMixture, PoseMixture
from symsol_annot.bench.models.networks.reference_model import ReferenceModel, single_or_double

SET_SIZES = 8  # between which a network tells how large an image's set is
_VIEW_HIDDEN = 96


@dataclass(frozen=True)
class Heads:
    """Which parts a density has.

    Attributes:
        poses: components on SO(3); 0 for none.
        axes: components of the axis; 0 for none.
        tells_set_size: whether the size of the symmetry set is told.
        tells_marking: whether it is told that the marking shows, and in which views it does not.
    """

    poses: int = 0
    axes: int = 0
    tells_set_size: bool = False
    tells_marking: bool = False

    @property
    def numbers(self) -> list[int]:
        """How many numbers each part is made of."""
        return [
            SET_SIZES * self.tells_set_size,
            1 * self.tells_marking,
            (AXIS_NUMBERS * self.axes + 1) * bool(self.axes),
            (POSE_NUMBERS * self.poses + 1) * bool(self.poses),
        ]


class Told:
    """What a network tells of B images; asking for a part that its density has not is a KeyError.

    Args:
        parts: by the names of the properties.
    """

    def __init__(self, **parts: Tensor | AxisMixture | PoseMixture) -> None:
        self._parts: dict[str, Any] = parts

    @property
    def images(self) -> int:
        """B."""
        return next(len(part) for part in self._parts.values())

    @property
    def set_size(self) -> Tensor:
        """(B, 8) logits of the size of the symmetry set."""
        size: Tensor = self._parts["set_size"]
        return size

    @property
    def is_shown(self) -> Tensor:
        """(B,) logits that the marking shows."""
        shown: Tensor = self._parts["is_shown"]
        return shown

    @property
    def axis(self) -> AxisMixture:
        """Densities of the body's axis, seen from the camera."""
        axis: AxisMixture = self._parts["axis"]
        return axis

    @property
    def pose(self) -> PoseMixture:
        """Densities of R_m2c."""
        pose: PoseMixture = self._parts["pose"]
        return pose

    def cpu(self) -> "Told":
        """Return it in the processor's memory, where single images are worked out."""
        return Told(**{name: part.cpu() for name, part in self._parts.items()})

    def row(self, i: int) -> "Told":
        """Return what is told of one image."""
        return Told(
            **{name: part[i : i + 1] if isinstance(part, Tensor) else part.row(i) for name, part in self._parts.items()}
        )


class MixtureNetwork(ReferenceModel):
    """The first stage, and one layer to the numbers that mixtures are made of.

    Args:
        heads: which parts the density has.
        pretrained: where the backbone begins: "imagenet", the path of a file of its weights, or None, at random.
        rng: draws the weights of what is not pretrained, see `initialise`.
        backbone: of the first stage.
        input_size: the side in pixels that it reduces images to; 0 for images as they are.

    Raises:
        WeightsError: the pretrained weights cannot be had.
    """

    def __init__(
        self,
        heads: Heads,
        *,
        pretrained: str | Path | None,
        rng: torch.Generator,
        backbone: Backbone = RESNET18,
        input_size: int = 0,
    ) -> None:
        with torch.random.fork_rng(devices=[]):  # torch's layers draw weights that are drawn again below
            super().__init__(backbone, input_size)
            self.output = nn.Linear(EMBEDDING_SIZE, sum(heads.numbers))
            if heads.tells_marking:
                self.view = nn.Sequential(
                    *(nn.Linear(3, _VIEW_HIDDEN), nn.Tanh()),
                    *(nn.Linear(_VIEW_HIDDEN, _VIEW_HIDDEN), nn.Tanh()),
                    nn.Linear(_VIEW_HIDDEN, 1),
                )
        self.heads = heads
        self.begin(pretrained, rng)

    def told(self, embeddings: Tensor, *, is_directed: bool = False) -> Told:
        """Return what the network tells of embedded images (B, E).

        Args:
            embeddings: of the first stage.
            is_directed: whether the body's axis has a direction.
        """
        size, shown, axes, poses = torch.split(single_or_double(self.output(embeddings)), self.heads.numbers, dim=1)
        parts: dict[str, Tensor | AxisMixture | PoseMixture] = {}
        if self.heads.tells_set_size:
            parts["set_size"] = size
        if self.heads.tells_marking:
            parts["is_shown"] = shown[:, 0]
        if self.heads.axes:
            parts["axis"] = AxisMixture.from_output(*_numbers(axes, self.heads.axes), is_directed=is_directed)
        if self.heads.poses:
            parts["pose"] = PoseMixture.from_output(*_numbers(poses, self.heads.poses))
        return Told(**parts)

    def hides(self, view: Tensor) -> Tensor:
        """Return logits (...) that the marking is hidden from viewing directions (..., 3), R's last row."""
        logits: Tensor = self.view(view)
        return logits[..., 0]

    def hides_on_cpu(self) -> Callable[[Tensor], Tensor]:
        """Return `hides` as the weights are now, for directions in the processor's memory."""
        network = copy.deepcopy(self.view).cpu()
        return lambda view: network(view)[..., 0]


def _numbers(values: Tensor, components: int) -> tuple[Tensor, Tensor]:
    """Return the numbers (B, M, n) of components, and the logit (B, 1) of the uniform one."""
    return values[:, :-1].reshape(len(values), components, -1), values[:, -1:]
