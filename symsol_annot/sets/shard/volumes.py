"""Volumes of SO(3) as a shard has them: masks of the grid's cells, 8 cells per byte, one by one, and deflated."""

import hashlib
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import CELLS, VOLUME_LEVEL, Volume
from symsol_annot.sets.shard.chunks import deflated, inflated_up_to

MAX_VOLUMES = 16  # of a shard, each another one
BYTES_PER_VOLUME = CELLS // 8


def bits_of(volumes: list[Volume]) -> npt.NDArray[np.uint8]:
    """Return the bits (V, 294912) of volumes, the first cell the highest bit of a byte."""
    return np.array([np.packbits(volume.mask) for volume in volumes], np.uint8).reshape(-1, BYTES_PER_VOLUME)


def attributes_of(bits: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.uint8], str]:
    """Return what a shard's attributes say of bits (V, 294912): them, deflated (k,), and their SHA-256."""
    data = bits.tobytes()
    return np.frombuffer(deflated(data), np.uint8), hashlib.sha256(data).hexdigest()


def volumes_stated(data: npt.NDArray[np.generic], sha256: str) -> npt.NDArray[np.uint8]:
    """Return the bits (V, 294912) of volumes that attributes state.

    Raises:
        ValueError: they are no volumes of the format's level, or damaged.
    """
    if data.dtype.str != "|u1" or data.ndim != 1:
        raise ValueError(f"expected |u1 of shape (k,), found {data.dtype.str} of shape {data.shape}")
    values = inflated_up_to(data.tobytes(), MAX_VOLUMES * BYTES_PER_VOLUME)
    if hashlib.sha256(values).hexdigest() != sha256:
        raise ValueError("is damaged: it does not have the digest in 'volumes_sha256'")
    if len(values) % BYTES_PER_VOLUME:
        raise ValueError(
            f"expected masks of the {CELLS:,} cells of the grid of level {VOLUME_LEVEL}, {BYTES_PER_VOLUME:,} bytes "
            f"each, found {len(values):,} bytes: a mask of another level"
        )
    bits = np.frombuffer(values, np.uint8).reshape(-1, BYTES_PER_VOLUME)
    if not bits.any(axis=1).all() or len({row.tobytes() for row in bits}) < len(bits):
        raise ValueError("a volume is empty, or there twice")
    return bits


@lru_cache(maxsize=8)
def volumes_of(data: bytes) -> tuple[Volume, ...]:
    """Return the volumes of bits (V, 294912), as bytes; shards of one set, which have the same ones, share them."""
    bits = np.frombuffer(data, np.uint8).reshape(-1, BYTES_PER_VOLUME)
    return tuple(Volume(np.unpackbits(row).astype(bool)) for row in bits)
