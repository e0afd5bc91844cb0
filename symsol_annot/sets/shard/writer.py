"""Writing a shard whole: it is built in memory, so that a full disk is an ordinary error.

Its bytes depend on nothing but its contents and the libraries in `storage_versions`.
"""

import hashlib
import math
import uuid
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.rendering.renderer import View
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.shard.chunks import GZIP_LEVEL, deflate_version, inflated, stored
from symsol_annot.sets.shard.header import ShardHeader, content_heading
from symsol_annot.sets.shard.layout import GROUP, GROUP_SHA256, SYMMETRY_MASK, VOLUME, VOLUMES, VOLUMES_SHA256
from symsol_annot.sets.shard.volumes import attributes_of, bits_of
from symsol_annot.sets.stated.settings import RenderedSettings, SealedSettings
from symsol_annot.system.closing import Closing

_MOST_IN_OLDEST = 900  # symmetries: an attribute of HDF5's oldest format holds 64 KiB


@dataclass(frozen=True)
class ImageRecord:
    """What a shard holds of one image.

    Attributes:
        view: the picture, its segmentation, the areas of its parts, and its depth where the set has that.
        R_m2c: (3, 3) the rotation it was drawn at.
        coset_px: the marking's area in pixels, as `Annotator.coset_px` gives it; its key is marking_pixels.
        symmetry_mask: (G,) bool, or None in a split without annotation.
        volume: the part of SO(3) that its set fills; None where it fills none.
    """

    view: View
    R_m2c: Rotations
    coset_px: float
    symmetry_mask: npt.NDArray[np.bool_] | None
    volume: Volume | None = None


@dataclass(frozen=True)
class ShardFile:
    """A finished shard in memory: its bytes, and the digest of what it holds whatever HDF5 makes of it."""

    data: bytes
    content_sha256: str


class ShardWriter(Closing):
    """Builds one shard, image by image; the chunks are made here, not by HDF5, so that threads do so at once."""

    def __init__(self, header: ShardHeader, count: int, symmetry_group: Rotations, *, annotated: bool) -> None:
        """Begin a shard of `count` images over a group (G, 3, 3)."""
        self._file = _new_file(len(symmetry_group))
        self._count, self._written = count, 0
        self._group = np.ascontiguousarray(symmetry_group, dtype="<f8")
        self._file.attrs.update(header.to_attributes())
        self._file.attrs.create(GROUP, self._group)
        self._file.attrs[GROUP_SHA256] = hashlib.sha256(self._group.tobytes()).hexdigest()
        settings = header.settings
        width, height = settings.image_size
        self._image = self._create("image", (count, height, width, 3), "u1", chunk_rows=1)
        self._maps: dict[str, h5py.Dataset] = {}
        self._labels: dict[str, npt.NDArray[Any]] = {}
        if not isinstance(settings, SealedSettings):
            self._labels["rotation"] = np.zeros((count, 3, 3))
        if isinstance(settings, RenderedSettings):
            maps = {"segmentation": "u1", **({"depth": "f4"} if settings.has_depth else {})}
            self._maps = {
                name: self._create(name, (count, height, width), dtype, chunk_rows=1) for name, dtype in maps.items()
            }
            self._labels["marking_pixels"] = np.zeros(count, dtype="f4")
            self._labels["part_pixels"] = np.zeros((count, len(settings.parts)), dtype="f4")
        if annotated:
            self._labels[SYMMETRY_MASK] = np.zeros((count, len(symmetry_group)), dtype=bool)
            equality = settings.equality if isinstance(settings, RenderedSettings) else None
            if equality is not None and equality.has_all_rotations:
                self._labels[VOLUME] = np.full(count, -1, dtype="<i4")
        self._volumes: list[Volume] = []  # each once, in the order of the images that first have it
        self._content = hashlib.sha256(_heading(self._image))
        self._stored: dict[str, list[bytes]] = {name: [] for name in self._maps}  # until their turn in the digest

    def add(self, record: ImageRecord) -> None:
        """Append one rendered image."""
        row, view = self._written, record.view
        self.add_imported(view.rgb, record.R_m2c, record.symmetry_mask)
        for name, dataset in self._maps.items():
            values = np.asarray(view.segmentation if name == "segmentation" else view.depth)
            self._stored[name].append(_store(dataset, row, values[None]))
        self._labels["marking_pixels"][row] = record.coset_px
        self._labels["part_pixels"][row] = view.part_pixels
        if record.volume is not None:
            if record.volume not in self._volumes:
                self._volumes.append(record.volume)
            self._labels[VOLUME][row] = self._volumes.index(record.volume)

    def add_imported(self, rgb: npt.NDArray[np.uint8], R: Rotations, mask: npt.NDArray[np.bool_] | None) -> None:
        """Append one image (H, W, 3) of which nothing is known but its rotation (3, 3) and its set (G,), if that."""
        row = self._written
        self._labels["rotation"][row] = R
        if mask is not None:
            self._labels[SYMMETRY_MASK][row] = mask
        self.add_sealed(rgb)

    def add_sealed(self, rgb: npt.NDArray[np.uint8]) -> None:
        """Append one image (H, W, 3) without labels."""
        _store(self._image, self._written, rgb[None])
        self._content.update(rgb.tobytes())
        self._written += 1

    def finish(self, notes: dict[str, int]) -> ShardFile:
        """Return the shard; `notes` become attributes."""
        if self._written != self._count:
            raise ValueError(f"the shard was made for {self._count} images and holds {self._written}")
        self._file.attrs.update(notes)
        for name, dataset in self._maps.items():
            self._content.update(_heading(dataset))
            for chunk in self._stored[name]:
                self._content.update(inflated(chunk, math.prod(dataset.chunks) * dataset.dtype.itemsize))
        for name, values in self._labels.items():
            dataset = self._create(name, values.shape, values.dtype.str)
            _store(dataset, 0, values)
            self._content.update(_heading(dataset) + values.tobytes())
        self._content.update(content_heading(GROUP, self._group.dtype.str, self._group.shape) + self._group.tobytes())
        if VOLUME in self._labels:
            bits = bits_of(self._volumes)
            self._file.attrs[VOLUMES], self._file.attrs[VOLUMES_SHA256] = attributes_of(bits)
            self._content.update(content_heading(VOLUMES, bits.dtype.str, bits.shape) + bits.tobytes())
        self._file.flush()
        return ShardFile(self._file.id.get_file_image(), self._content.hexdigest())

    def close(self) -> None:
        """Let go of the memory."""
        self._file.close()

    def _create(self, name: str, shape: tuple[int, ...], dtype: str, chunk_rows: int | None = None) -> h5py.Dataset:
        return self._file.create_dataset(
            name,
            shape,
            dtype,
            chunks=(chunk_rows or shape[0], *shape[1:]),
            compression="gzip",
            compression_opts=GZIP_LEVEL,
            fletcher32=True,
            track_times=False,
        )


def _new_file(symmetries: int) -> h5py.File:
    """Return an empty file in memory, of the oldest of HDF5's formats that holds so many symmetries in an attribute."""
    plist = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    plist.set_obj_track_times(False)  # of the root; the oldest format has none
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fapl_core(backing_store=False)
    access.set_fclose_degree(h5py.h5f.CLOSE_STRONG)
    newer = h5py.h5f.LIBVER_V18
    access.set_libver_bounds(h5py.h5f.LIBVER_EARLIEST if symmetries <= _MOST_IN_OLDEST else newer, newer)
    in_memory = f"shard-{uuid.uuid4()}"  # HDF5 tells files that are open at the same time apart by name
    return h5py.File(h5py.h5f.create(in_memory.encode(), h5py.h5f.ACC_TRUNC, plist, access))


def _store(dataset: h5py.Dataset, row: int, values: npt.NDArray[Any]) -> bytes:
    """Write the chunk that begins at a row, and return its bytes."""
    if values.shape != dataset.chunks or values.dtype != dataset.dtype:
        expected, found = f"{dataset.dtype} {dataset.chunks}", f"{values.dtype} {values.shape}"
        raise ValueError(f"{dataset.name}: expected {expected}, found {found}")
    chunk = stored(values)
    dataset.id.write_direct_chunk((row, *[0] * (values.ndim - 1)), chunk)
    return chunk


def _heading(dataset: h5py.Dataset) -> bytes:
    return content_heading(dataset.name.strip("/"), dataset.dtype.str, dataset.shape)


def storage_versions() -> dict[str, str]:
    """Return the libraries that decide a shard's bytes: name to version."""
    versions = {"numpy": np.__version__, "h5py": h5py.__version__, "hdf5": h5py.version.hdf5_version}
    return {**versions, "zlib-ng": deflate_version()}
