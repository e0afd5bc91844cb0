"""The HDF5 shard, opened safely: a file of unknown origin is held against docs/format.md before it is read.

HDF5 sees the file in a child process alone, which says what the file is and where its chunks lie. The bytes of the
chunks are read here, from the file itself.
"""

import atexit
import contextlib
import hashlib
import json
import math
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import DamageError, DataError, bulleted
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import SAMPLES_PER_AXIS
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.shard.chunks import ByteFile, StoredArray
from symsol_annot.sets.shard.header import content_heading
from symsol_annot.sets.shard.layout import (
    ALL_ATTRIBUTES,
    EQUALITY,
    GROUP,
    IMPORTED,
    LAYOUTS,
    PARTS,
    SYMMETRY_MASK,
    VOLUME,
    VOLUMES,
    VOLUMES_SHA256,
    ShardKind,
    ShardLayout,
)
from symsol_annot.sets.shard.structure import parts_stated, shown, structure_of
from symsol_annot.sets.shard.volumes import BYTES_PER_VOLUME, volumes_of, volumes_stated
from symsol_annot.sets.stated.equality import Equality, equality_stated
from symsol_annot.system.sandbox.hdf5_process import Description, Hdf5Process, Limits

_LIMITS = Limits(seconds=60.0, processor_seconds=2.0, memory_bytes=2**30)  # a good shard takes 0.01 s


@dataclass(frozen=True, eq=False)
class ShardLabels:
    """What a shard says of its N images, without the images.

    Attributes:
        rotation: (N, 3, 3) f8, R_m2c; None in a sealed shard.
        symmetry_group: (G, 3, 3) f8, the body's symmetries.
        marking_pixels: (N,) f4, the marking's visible area in pixels; None in an imported or a sealed shard.
        part_pixels: (N, P) f4, the visible area of each part in pixels; None in these, and in version 1.
        symmetry_mask: (N, G) bool, which of the symmetries are in each image's set; None without symmetry sets.
        volume: (N,) i4, which of `volumes` belongs to each image's set, -1 for none; None where sets have none.
        volumes: the volumes that sets of the shard have.
    """

    rotation: Rotations | None
    symmetry_group: Rotations
    marking_pixels: npt.NDArray[np.float32] | None
    part_pixels: npt.NDArray[np.float32] | None
    symmetry_mask: npt.NDArray[np.bool_] | None
    volume: npt.NDArray[np.int32] | None = None
    volumes: tuple[Volume, ...] = ()


@dataclass(frozen=True, eq=False)
class Shard:
    """An open shard whose structure is the format's; what its arrays hold is for `laws` to say.

    Attributes:
        path: of the file.
        file: of its bytes.
        attributes: as docs/format.md lists them, but for arrays.
        array_attributes: those that are arrays.
        arrays: data sets by name.
    """

    path: Path
    file: ByteFile
    attributes: Mapping[str, Any]
    array_attributes: Mapping[str, npt.NDArray[Any]]
    arrays: Mapping[str, StoredArray]

    def __len__(self) -> int:
        return self.arrays["image"].shape[0]

    @property
    def layout(self) -> ShardLayout:
        """What its version of the format has."""
        return LAYOUTS[self.attributes["format_version"]]

    @property
    def _kind(self) -> ShardKind:
        return self.layout.kind_of(self.attributes)

    @property
    def is_imported(self) -> bool:
        """Whether its images are from elsewhere."""
        return self._kind is IMPORTED

    @property
    def is_annotated(self) -> bool:
        """Whether its images have symmetry sets."""
        return SYMMETRY_MASK in self.arrays

    @property
    def first_index(self) -> int:
        """The index within the split of the shard's first image."""
        return int(self.attributes["first_index"])

    @property
    def tolerance_px(self) -> float:
        """The object's T in pixels; NaN without a marking and in an imported shard."""
        return float(self.attributes.get("tolerance_px", math.nan))

    @property
    def candidates_drawn(self) -> int:
        """Of how many candidates the marking's area was needed; 0 in an imported shard."""
        return int(self.attributes.get("candidates_drawn", 0))

    @property
    def candidates_within_tolerance(self) -> int:
        """Of how many of these candidates it was below the tolerance but not 0; 0 in an imported shard."""
        return int(self.attributes.get("candidates_within_tolerance", 0))

    @property
    def parts(self) -> tuple[str, ...]:
        """The names of the parts, the first of id 1; none in an imported or a sealed shard."""
        if self.segmentation is None:
            return ()
        if self.layout.has_parts:
            return parts_stated(self.attributes[PARTS])
        return ("body",) if math.isnan(self.tolerance_px) else ("body", "marking")

    @property
    def equality(self) -> Equality | None:
        """The object's parts, and its rule; None for an object of format version 1."""
        text = self.attributes.get(EQUALITY)
        return None if text is None else equality_stated(text)

    @property
    def most_pixels(self) -> float:
        """The area in pixels of the camera's coarsest lattice, which reaches beyond the image by half a point's."""
        _, height, width, _ = self.arrays["image"].shape
        lattice = Camera(1.0, 1.0, width, height).lattice(SAMPLES_PER_AXIS[0])
        return lattice.width * lattice.height / SAMPLES_PER_AXIS[0] ** 2

    @property
    def image(self) -> StoredArray:
        """The images, (N, H, W, 3) u8 RGB, to be read row by row."""
        return self.arrays["image"]

    @property
    def segmentation(self) -> StoredArray | None:
        """The segmentations, (N, H, W) u8, to be read row by row; None in an imported shard."""
        return self.arrays.get("segmentation")

    @property
    def depth(self) -> StoredArray | None:
        """The depths, (N, H, W) f4, to be read row by row; None where the set has none."""
        return self.arrays.get("depth")

    def labels(self) -> ShardLabels:
        """Read the labels of all images.

        Raises:
            DataError: one is damaged.
        """
        rotation, pixels, part_pixels, mask, volume = (
            self.read(name) if name in self.arrays else None
            for name in ("rotation", "marking_pixels", "part_pixels", SYMMETRY_MASK, VOLUME)
        )
        volumes = () if volume is None else volumes_of(self.volume_bits.tobytes())
        return ShardLabels(rotation, self._group(), pixels, part_pixels, mask, volume, volumes)

    @property
    def volume_bits(self) -> npt.NDArray[np.uint8]:
        """The (V, 294912) u8 masks of the volumes that its sets have, 8 cells per byte; none in most shards."""
        if VOLUMES not in self.array_attributes:
            return np.zeros((0, BYTES_PER_VOLUME), np.uint8)
        return volumes_stated(self.array_attributes[VOLUMES], self.attributes[VOLUMES_SHA256])

    def _group(self) -> Rotations:
        if self.layout.has_group_attribute:
            return self.array_attributes[GROUP]
        return self.read(GROUP)

    @property
    def versions_text(self) -> str:
        """The software that it was made with, as it stands in the file."""
        return str(self.attributes["versions"])

    @property
    def versions(self) -> dict[str, str]:
        """The software that it was made with: name to version.

        Raises:
            DataError: the attribute is no JSON object of texts.
        """
        try:
            found = json.loads(self.versions_text)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict) or not all(isinstance(version, str) for version in found.values()):
            raise DataError(f"{self.path}: attribute 'versions' is no JSON object of texts")
        return found

    def read(self, name: str) -> npt.NDArray[Any]:
        """Return a whole data set, of labels.

        Raises:
            DataError: it is damaged.
        """
        with self._damage():
            return self.arrays[name].whole(self.file)

    def rows(self, name: str) -> Iterator[npt.NDArray[Any]]:
        """Yield a data set of images row by row.

        Raises:
            DataError: a row is damaged.
        """
        for row in range(len(self)):
            with self._damage():
                values = self.arrays[name].row(row, self.file)
            yield values

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except DamageError as error:
            raise DataError(f"{self.path}: {error}") from None


def content_sha256(shard: Shard) -> str:
    """Return the digest of a shard's arrays, one that another HDF5 library or compression does not change.

    Raises:
        DataError: a chunk is damaged.
    """
    digest = hashlib.sha256()
    for column in shard.layout.columns:
        if column.name in shard.arrays:
            array = shard.arrays[column.name]
            digest.update(content_heading(column.name, array.dtype, array.shape))
            for values in shard.rows(column.name) if column.is_picture else [shard.read(column.name)]:
                digest.update(values.tobytes())
    of_attributes = [(GROUP, shard.array_attributes[GROUP])] if shard.layout.has_group_attribute else []
    of_attributes += [(VOLUMES, shard.volume_bits)] if VOLUMES in shard.array_attributes else []
    for name, values in of_attributes:
        digest.update(content_heading(name, values.dtype.str, values.shape) + values.tobytes())
    return digest.hexdigest()


@contextmanager
def open_shard(path: Path) -> Iterator[Shard]:
    """Open a shard for reading after checking that it holds what the format says and nothing else.

    Raises:
        DataError: the file is missing, is no HDF5, or is no shard; the message lists every fault.
    """
    shard = opened_shard(path)
    try:
        yield shard
    finally:
        shard.file.close()


def opened_shard(path: Path, sha256: str | None = None, size: int | None = None) -> Shard:
    """Return a shard that was opened as by `open_shard`; its file is closed once nothing refers to it, or at an error.

    Args:
        path: of the file.
        sha256: what its SHA-256 has to be; None where that is not to be looked at.
        size: how many bytes it has to have, likewise.

    Raises:
        DataError: as `open_shard`; or it is damaged, and HDF5 was not asked about it.
    """
    file = _file_of(path)
    with contextlib.ExitStack() as at_an_error:
        at_an_error.callback(file.close)
        _refuse_other_bytes(path, file, sha256, size)
        try:
            described = _DESCRIBER.describe(path)
        except DamageError as fault:
            raise DataError(f"{path}: {fault}") from None
        if described.identity != file.identity:
            raise DataError(f"{path}: was replaced while it was opened; try again")
        faults, arrays = structure_of(described, file.identity[2])
        if faults:
            raise DataError(f"{path}: is no valid shard:\n" + bulleted(faults))
        at_an_error.pop_all()
    return Shard(path, file, described.attributes, described.arrays, arrays)


def header_mismatches(shard: Shard, expected: dict[str, Any]) -> list[str]:
    """Say which attributes of a shard are not the expected ones, as `ShardHeader.to_attributes` names them."""
    found = shard.attributes
    return [
        f"attribute {name!r}: expected {value!r}, found {shown(found.get(name))}"
        for name, value in expected.items()
        if found.get(name) != value and not (value != value and _is_nan(found.get(name)))  # noqa: PLR0124 - NaN
    ]


def _file_of(path: Path) -> ByteFile:
    try:
        return ByteFile(path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such shard") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be opened: {error.strerror}") from None


def _refuse_other_bytes(path: Path, file: ByteFile, sha256: str | None, size: int | None) -> None:
    advice = (
        "`symsol-annot verify` says what else is wrong with the set, and with --repair makes damaged shards again; "
        "or fetch the file again"
    )
    if size is not None and file.identity[2] != size:
        raise DataError(f"{path}: is damaged: expected {size} bytes, found {file.identity[2]}. {advice}")
    if sha256 is None:
        return
    try:
        found = file.sha256()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    if found != sha256:
        raise DataError(f"{path}: is damaged: expected SHA-256 {sha256}, found {found}. {advice}")


class _Describer:
    """Asks a child process about shards: one for this process, started when it is first needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: Hdf5Process | None = None
        self._inherited: list[Hdf5Process] = []  # kept, so that no process waits for the child of another one

    def start(self) -> None:
        """Start the process if there is none, so that it is ready when it is needed; a failure shows then."""
        with self._lock, contextlib.suppress(DamageError):
            self._process = self._process or Hdf5Process(_LIMITS)

    def describe(self, path: Path) -> Description:
        """Return what a file is, and where the chunks of its data sets lie.

        Raises:
            DamageError: it is damaged, describing it crashed or took too long, or the process cannot be started.
        """
        with self._lock:
            process, self._process = self._process, None
            if process and process.has_ended:  # it was ended from outside: no fault of this file
                process.close()
                process = None
            process = process or Hdf5Process(_LIMITS)
            with contextlib.ExitStack() as at_an_error:
                at_an_error.callback(process.close)  # it may be half-way through an answer, or damaged
                process.begin_to_open(path, ALL_ATTRIBUTES)
                described = process.description()
                at_an_error.pop_all()
            self._process = process
            return described

    def close(self) -> None:
        """End the process."""
        with self._lock:
            if self._process:
                self._process.close()
                self._process = None

    def forget(self) -> None:
        """Leave the process to the parent of this one, which was forked."""
        if self._process:
            self._inherited.append(self._process)
        self._process, self._lock = None, threading.Lock()


_DESCRIBER = _Describer()
prepare_to_open = _DESCRIBER.start
atexit.register(_DESCRIBER.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_DESCRIBER.forget)


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and np.isnan(value).item()
