"""What happens while a set is made, to be shown or logged."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class Started:
    """The work is known.

    Attributes:
        images, shards: of the whole set.
        images_there, shards_there: of those, how many the folder holds already.
    """

    images: int
    shards: int
    images_there: int
    shards_there: int


@dataclass(frozen=True)
class ObjectChecked:
    """The mesh of an object that is not built in has the declared group, and no larger one where that was looked for.

    Attributes:
        group: in words, with what it nearly has.
        residual: how far the surface is from having it, in radii.
        notes: what was not looked for, and what is close to the tolerance; whole lines.
    """

    group: str
    residual: float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ForeignShardsFound:
    """The folder holds shards that are none of this set's; they are left alone."""

    files: tuple[str, ...]


@dataclass(frozen=True)
class ImagesMade:
    """So many more images are made; none is counted twice, also where its shard is begun again."""

    images: int


@dataclass(frozen=True)
class ShardFinished:
    """A shard is in the folder, made by a worker."""

    shard: str
    images: int
    worker: str


@dataclass(frozen=True)
class ShardBegunAgain:
    """A worker failed at a shard, which is begun again: the attempt that failed (1 is the first), and why."""

    shard: str
    worker: str
    attempt: int
    reason: str


@dataclass(frozen=True)
class WorkersGone:
    """There is no worker at the moment; the work waits for one."""


Event: TypeAlias = (
    Started | ObjectChecked | ForeignShardsFound | ImagesMade | ShardFinished | ShardBegunAgain | WorkersGone
)
OnEvent: TypeAlias = Callable[[Event], object]


def ignore(_: Event) -> None:
    """Take no notice."""
