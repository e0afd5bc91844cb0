"""A set as WebDataset: one tar file per shard, in which the files of one image follow each other and share a name.

Image 3 of a split has 000003.png, 000003.segmentation.png and 000003.json; a tar file's JSON holds what is no picture.
"""

import io
import json
import math
import tarfile
from collections.abc import Iterable
from typing import Any

import numpy as np

from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Sample
from symsol_annot.system.png import to_png

GROUP_FILE = "symmetry_group.npy"


def samples_to_tar(samples: Iterable[Sample]) -> bytes:
    """Return samples as a tar file; the same samples give the same bytes, on the same zlib-ng."""
    written = io.BytesIO()
    with tarfile.open(fileobj=written, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for sample in samples:
            name = f"{sample.index:06d}"
            _add(archive, f"{name}.png", to_png(sample.image))
            if sample.segmentation is not None:
                _add(archive, f"{name}.segmentation.png", to_png(sample.segmentation))
            _add(archive, f"{name}.json", json.dumps(_labels(sample)).encode())
    return written.getvalue()


def group_to_npy(symmetry_group: Rotations) -> bytes:
    """Return a symmetry group (G, 3, 3) as a file of numpy's, float64."""
    written = io.BytesIO()
    np.save(written, np.ascontiguousarray(symmetry_group, dtype="<f8"), allow_pickle=False)
    return written.getvalue()


def _labels(sample: Sample) -> dict[str, Any]:
    """Return what is known of an image: floats to the last bit; members of its set by their numbers in the group."""
    members = np.flatnonzero(sample.symmetry_mask).tolist() if sample.symmetry_mask is not None else None
    pixels, parts = float(sample.marking_pixels), sample.part_pixels
    return {
        "index": sample.index,
        "rotation": sample.rotation.tolist(),
        "symmetries": members,
        "marking_pixels": None if math.isnan(pixels) else pixels,
        "marking_visible": sample.marking_visible,
        "part_pixels": None if parts is None else [float(area) for area in parts],
    }


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)  # without a time or an owner
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))
