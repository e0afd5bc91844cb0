"""The recipe of a mixture density on SO(3)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Literal

from symsol_annot.bench.models.networks.backbones import BACKBONES, RESNET18
from symsol_annot.bench.models.recipe_keys import LEFT_OUT, TrainingKeys, backbone_key, faults_of_start, outside
from symsol_annot.rotations.grid import STANDARD_LEVEL, grid_size
from symsol_annot.system.text.tables import OneOf

FREE, GROUP, CIRCLE, MARKED_CIRCLE = "free", "group", "circle", "marked-circle"
_MAX_COMPONENTS, _MAX_MEMBERS = 1024, 4096


@dataclass(frozen=True, kw_only=True)
class MixtureRecipe(TrainingKeys):
    """How a MixtureNetwork is trained.

    Attributes:
        structure: of the density: "free", components anywhere; "group", the same at all rotations of the body's group;
            "circle", of the body's axis alone; "marked-circle", of the axis, and of the pose where the marking shows.
        components: M, of rotations.
        axis_components: of the axis.
        members: how many members of an image's set a step learns from, drawn anew; all of a set with fewer.
        largest_set: up to which measure the sizes of sets are told, in rotations of the grid of level 4, of an object
            whose sets may fill a volume; 0 for the number of candidates.
        marking_weight: of the losses of what is told beside the density: the set's size, and whether the marking shows.
        start: of the backbone: published weights by their name, or "random".
        backbone: of the first stage, by its name.
    """

    structure: Literal["free", "group", "circle", "marked-circle"]
    components: int = 32
    axis_components: int = 4
    members: int = 12
    marking_weight: float = 2.0
    largest_set: int = field(default=0, metadata={LEFT_OUT: True})
    start: Literal["imagenet", "random"] = "random"
    backbone: Annotated[str, OneOf(BACKBONES)] = backbone_key(RESNET18)

    @property
    def needs_members(self) -> bool:
        """Whether batches have to say which candidates are members of their images' sets."""
        return self.structure in (FREE, MARKED_CIRCLE)

    @property
    def needs_volumes(self) -> bool:
        """Whether batches have to have the volumes of their images' sets."""
        return self.largest_set > 0

    def faults(self) -> Iterator[str]:
        """Say what makes no sense."""
        yield from super().faults()
        if self.largest_set and self.structure != FREE:
            yield f'largest_set: is for "{FREE}", which tells the size of a set; the structure is "{self.structure}"'
        yield from outside(
            self,
            components=(1, _MAX_COMPONENTS),
            axis_components=(1, _MAX_COMPONENTS),
            members=(1, _MAX_MEMBERS),
            marking_weight=(0.0, 1e6),
            largest_set=(0, grid_size(STANDARD_LEVEL)),
        )
        yield from faults_of_start(self.start, BACKBONES[self.backbone])
