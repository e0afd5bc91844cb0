"""Data sets of a predictions file on their way into it: columns, made of the answers about single images."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Column:
    """A data set to be written: its shape and type, and its rows in blocks that follow one another."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    blocks: Iterable[Array]


class Answers(Protocol):
    """What was answered about each image of a split, arrays by the names of data sets."""

    @property
    def images(self) -> int:
        """How many images there are."""

    def first(self, name: str) -> Array:
        """Return what the first image has under a name, for its shape and type."""

    def each(self, name: str) -> Iterator[Array]:
        """Yield what each image has under a name, in the order of the images."""

    def lengths(self, name: str) -> npt.NDArray[np.int64]:
        """Return how many entries each image has under a name, (N,)."""


def whole_column(array: Array) -> Column:
    """Return a whole array as a column."""
    return Column(array.shape, array.dtype, [array])


def dense_column(answers: Answers, name: str) -> Column:
    """Return a column (N, ...) with one row per image."""
    first = answers.first(name)
    return Column((answers.images, *first.shape), first.dtype, (rows[None] for rows in answers.each(name)))


def sparse_columns(answers: Answers, offsets: str, indices: str, values: str) -> dict[str, Column]:
    """Return three columns of sparse rows: image r has the entries offsets[r] : offsets[r + 1].

    Args:
        answers: about all images.
        offsets: name of the column (N + 1,) int64.
        indices: name of the column (K,) of grid indices.
        values: name of the column (K,) of the values there.
    """
    lengths = answers.lengths(indices)
    bounds = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    entries = (int(lengths.sum()),)
    return {
        offsets: whole_column(bounds),
        **{name: Column(entries, answers.first(name).dtype, answers.each(name)) for name in (indices, values)},
    }
