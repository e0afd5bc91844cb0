"""How long work reports its progress."""

from collections.abc import Callable
from typing import TypeAlias

OnImages: TypeAlias = Callable[[int], object]  # told how many more images are done; the calls add up to all of them


def ignore_images(_: int) -> None:
    """Ignore a count of images: for work whose progress is not shown."""
