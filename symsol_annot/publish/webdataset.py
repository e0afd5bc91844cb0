"""A set as WebDataset: one tar file per shard, in which the files of one image follow each other and share a name.

Image 3 of a split has 000003.png, 000003.segmentation.png and 000003.json; a tar file's JSON holds what is no picture.
Symmetry group and volumes, which the JSON points into, are files of numpy's beside the tar files.
"""

import io
import json
import math
import tarfile
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Sample
from symsol_annot.sets.shard.volumes import bits_of
from symsol_annot.system.png import to_png

GROUP_FILE = "symmetry_group.npy"
VOLUMES_FILE = "volumes.npy"  # of sets that can fill a volume


def samples_to_tar(samples: Iterable[Sample], volumes: Sequence[Volume] | None = None) -> bytes:
    """Return samples as a tar file; the same samples give the same bytes, on the same zlib-ng.

    Args:
        samples: of one set, in order.
        volumes: those that sets of the object fill, into which the JSON's `volume` points, -1 for none; None of an
            object whose sets never do, whose JSON has no such entry.
    """
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for sample in samples:
            name = f"{sample.index:06d}"
            _add(archive, f"{name}.png", to_png(sample.image))
            if sample.segmentation is not None:
                _add(archive, f"{name}.segmentation.png", to_png(sample.segmentation))
            _add(archive, f"{name}.json", json.dumps(_labels(sample, volumes)).encode())
    return written.getvalue()


def group_to_npy(symmetry_group: Rotations) -> bytes:
    """Return a symmetry group (G, 3, 3) as a file of numpy's, float64."""
    return _to_npy(np.ascontiguousarray(symmetry_group, dtype="<f8"))


def volumes_to_npy(volumes: Sequence[Volume]) -> bytes:
    """Return volumes as a file of numpy's: bits (V, 294912) of the grid's cells, as in a shard, uint8."""
    return _to_npy(bits_of(list(volumes)))


def _to_npy(values: npt.NDArray[Any]) -> bytes:
    written = io.BytesIO()
    np.save(written, values, allow_pickle=False)
    return written.getvalue()


def _labels(sample: Sample, volumes: Sequence[Volume] | None) -> dict[str, Any]:
    """Return what is known of an image: floats to the last bit; members of its set by their numbers in the group."""
    members = np.flatnonzero(sample.symmetry_mask).tolist() if sample.symmetry_mask is not None else None
    pixels, parts = float(sample.marking_pixels), sample.part_pixels
    labels = {
        "index": sample.index,
        "rotation": sample.rotation.tolist(),
        "symmetries": members,
        "marking_pixels": None if math.isnan(pixels) else pixels,
        "marking_visible": sample.marking_visible,
        "part_pixels": None if parts is None else [float(area) for area in parts],
    }
    if volumes is not None:
        labels["volume"] = -1 if sample.volume is None else volumes.index(sample.volume)
    return labels


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)  # without a time or an owner
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))
