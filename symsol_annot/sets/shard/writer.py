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

from symsol_annot.rendering.renderer import View
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.settings import RenderedSettings
from symsol_annot.sets.shard.chunks import GZIP_LEVEL, deflate_version, inflated, stored
from symsol_annot.sets.shard.header import ShardHeader, content_heading
from symsol_annot.system.closing import Closing


@dataclass(frozen=True)
class ImageRecord:
    """What a shard holds of one image.

    Attributes:
        view: the picture and its segmentation.
        R_m2c: (3, 3) the rotation it was drawn at.
        coset_px: the marking's area in pixels, as `Annotator.coset_px` gives it; its key is marking_pixels.
        symmetry_mask: (G,) bool, or None in a split without annotation.
    """

    view: View
    R_m2c: Rotations
    coset_px: float
    symmetry_mask: npt.NDArray[np.bool_] | None


@dataclass(frozen=True)
class ShardFile:
    """A finished shard in memory: its bytes, and the digest of what it holds whatever HDF5 makes of it."""

    data: bytes
    content_sha256: str


class ShardWriter(Closing):
    """Builds one shard, image by image; the chunks are made here, not by HDF5, so that threads do so at once."""

    def __init__(self, header: ShardHeader, count: int, symmetry_group: Rotations, *, annotated: bool) -> None:
        in_memory = f"shard-{uuid.uuid4()}"  # HDF5 tells files that are open at the same time apart by name
        self._file = h5py.File(in_memory, "w", driver="core", backing_store=False, libver=("earliest", "v108"))
        self._count, self._written = count, 0
        self._file.attrs.update(header.to_attributes())
        width, height = header.settings.image_size
        self._image = self._create("image", (count, height, width, 3), "u1", chunk_rows=1)
        self._segmentation = None
        self._labels = {"rotation": np.zeros((count, 3, 3))}
        if isinstance(header.settings, RenderedSettings):
            self._segmentation = self._create("segmentation", (count, height, width), "u1", chunk_rows=1)
            self._labels["marking_pixels"] = np.zeros(count, dtype="f4")
        if annotated:
            self._labels["symmetry_mask"] = np.zeros((count, len(symmetry_group)), dtype=bool)
        self._labels["symmetry_group"] = symmetry_group
        self._content = hashlib.sha256(_heading(self._image))
        self._segmentations: list[bytes] = []  # as they are stored, until their turn in the digest

    def add(self, record: ImageRecord) -> None:
        """Append one rendered image."""
        row = self._written
        self.add_imported(record.view.rgb, record.R_m2c, record.symmetry_mask)
        self._segmentations.append(_store(self._segmentation, row, record.view.segmentation[None]))
        self._labels["marking_pixels"][row] = record.coset_px

    def add_imported(self, rgb: npt.NDArray[np.uint8], R: Rotations, mask: npt.NDArray[np.bool_] | None) -> None:
        """Append one image (H, W, 3) of which nothing is known but its rotation (3, 3) and its set (G,), if that."""
        row = self._written
        _store(self._image, row, rgb[None])
        self._content.update(rgb.tobytes())
        self._labels["rotation"][row] = R
        if mask is not None:
            self._labels["symmetry_mask"][row] = mask
        self._written += 1

    def finish(self, notes: dict[str, int]) -> ShardFile:
        """Return the shard; `notes` become attributes."""
        if self._written != self._count:
            raise ValueError(f"the shard was made for {self._count} images and holds {self._written}")
        self._file.attrs.update(notes)
        if self._segmentation is not None:
            self._content.update(_heading(self._segmentation))
            for chunk in self._segmentations:
                self._content.update(inflated(chunk, math.prod(self._segmentation.chunks)))
        for name, values in self._labels.items():
            dataset = self._create(name, values.shape, values.dtype.str)
            _store(dataset, 0, values)
            self._content.update(_heading(dataset) + values.tobytes())
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
