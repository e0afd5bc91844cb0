"""The order in which an epoch's images are read: shuffled, shard after shard, and shared among readers.

for row in symsol_annot.shuffled_order(train, seed=0, epoch=3):
    sample = train[row]
"""

import hashlib

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import SettingsError
from symsol_annot.sets.dataset import MAX_OPEN_SHARDS, Dataset

Numbers = npt.NDArray[np.int64]
_VERSION = 1  # of the orders: another algorithm, another number


def shuffled_order(dataset: Dataset, seed: int, epoch: int = 0, part: int = 0, parts: int = 1) -> Numbers:
    """Return the rows that one reader of an epoch reads, in its order.

    The shards are put in a random order, and within it each shard's images; this sequence is cut into `parts`. A part's
    shards are divided into windows of at most MAX_OPEN_SHARDS neighbours, and a window's images are shuffled together.
    So a reader opens a shard once, and readers share a shard only where it is cut.

    Random are the order of the shards, which images are on which side of a cut, and the order within a window. Not
    random: a window's images come near each other, and of pairs of neighbours at least one in 8 is of a single shard.
    A rotation is drawn independently of its index, so a shard is itself a random sample of the split.

    Args:
        dataset: of n images; a slice is one too. None of its files is read.
        seed: 0 or more.
        epoch: 0 or more; each has an order of its own.
        part: the reader's number. Worker w of W on rank r of R is reader r * W + w of R * W.
        parts: how many readers share the epoch.

    Returns:
        (m,) rows of `dataset`. The parts together hold each of the n rows once; m is n / parts, rounded down or up,
        and a rank's share is n / R, likewise. The order is the same in every process and on every machine.

    Raises:
        SettingsError: an argument is no integer or out of its range.
    """
    _check_at_least(0, seed=seed, epoch=epoch, part=part)
    _check_at_least(1, parts=parts)
    if part >= parts:
        raise SettingsError(f"part: expected 0 to {parts - 1}, as there are {parts} parts, found {part}")
    bits, n = _random_bits(seed, epoch), len(dataset)
    place = _shuffled_places(dataset.shard_numbers(), bits)
    sequence = np.lexsort((bits.random_raw(n), place))
    part, parts = int(part), int(parts)  # numpy's small integers overflow
    rows = sequence[n * part // parts : n * (part + 1) // parts]
    return rows[np.lexsort((bits.random_raw(n)[rows], _windows(place[rows])))].astype(np.int64)


def _check_at_least(least: int, **settings: object) -> None:
    for name, value in settings.items():
        if not isinstance(value, int | np.integer) or value < least:
            raise SettingsError(f"{name}: expected an integer of {least} or more, found {value!r}")


def _random_bits(seed: int, epoch: int) -> np.random.Philox:
    """Return an epoch's stream of 64-bit integers: raw ones, as numpy keeps no other the same between versions."""
    key = hashlib.sha256(f"symsol-annot order {_VERSION}/{int(seed)}/{int(epoch)}".encode()).digest()
    return np.random.Philox(key=np.frombuffer(key[:16], dtype="<u8"))


def _shuffled_places(shards: Numbers, bits: np.random.Philox) -> Numbers:
    """Return for each row (n,) at which place its shard comes, 0 to the number of shards that occur."""
    there, number = np.unique(shards, return_inverse=True)
    return np.argsort(bits.random_raw(len(there)), kind="stable")[number]


def _windows(place: Numbers) -> Numbers:
    """Return for each image (m,) of a part its window, given its shard's place; windows differ by at most one shard."""
    if not len(place):
        return place
    first, shards = place[0], place[-1] - place[0] + 1
    windows = -(-shards // MAX_OPEN_SHARDS)
    return (place - first) * windows // shards
