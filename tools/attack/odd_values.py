"""Values that no shard of ours has: labels that break a law, groups and parts that are none, depths beside the ids.

They are stored as the format stores values, so that it is the laws that have to refuse them.
"""

import zlib

import h5py
import numpy as np

_MOST_ROWS = 7000
_COMPRESSED = {"compression": "gzip", "fletcher32": True, "track_times": False}


def taken(file, name):
    """Take a data set out of a file; return its values."""
    values = values_of(file, name)
    del file[name]
    return values


def values_of(file, name):
    """Return a data set's values, of no more rows than memory has room for: an earlier change may have added some."""
    found = file[name]
    if not isinstance(found, h5py.Dataset):
        raise TypeError(f"{name} is no data set any more")
    return found[:_MOST_ROWS] if found.shape else found[...]


def _group(file):
    """Return the symmetry group, which is an attribute, or in version 1 a data set."""
    return file.attrs["symmetry_group"] if "symmetry_group" in file.attrs else values_of(file, "symmetry_group")


def _put_group(file, group):
    if "symmetry_group" in file:
        del file["symmetry_group"]
        file.create_dataset("symmetry_group", data=group, chunks=group.shape, **_COMPRESSED)
    else:
        file.attrs["symmetry_group"] = group


def wrong_rotations(file, place, rng):
    is_group = rng.random() < 0.5
    R = _group(file) if is_group else values_of(file, "rotation")
    at = int(rng.integers(len(R)))
    R[at] = [np.nan * R[at], 0 * R[at], -R[at], 2 * R[at], R[at] + 1e-3, np.diag([1.0, 1.0, -1.0])][rng.integers(6)]
    if is_group:
        _put_group(file, R)
    else:
        del file["rotation"]
        file.create_dataset("rotation", data=R, chunks=R.shape, **_COMPRESSED)


def no_group(file, place, rng):
    """Rotations of which the first is the identity, and no more."""
    group = _group(file)
    for at in range(1, len(group)):
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        group[at] = q * np.sign(np.linalg.det(q))
    if rng.random() < 0.3 and len(group) > 1:
        group = np.roll(group, 1, axis=0)
    _put_group(file, group)


def odd_group(file, place, rng):
    """A group's attribute of another type or shape, or one that there is not in version 1."""
    group = _group(file)
    large = np.zeros((int(rng.choice([7201, 2**15, 2**19])), 3, 3))
    odd = (
        *(group.astype("f4"), group.astype(">f8"), group.astype("c16"), group.astype("S8"), group > 0, large),
        *(group[:0], group[:-1], np.concatenate([group, group]), group.reshape(-1, 9), group[None], group[0], 1.0, "x"),
        *(h5py.Empty("f8"), np.array(["a", "b"], dtype=h5py.string_dtype()), np.zeros(3, "V8")),
    )
    file.attrs["symmetry_group"] = odd[rng.integers(len(odd))]


def odd_parts(file, place, rng):
    texts = ("", "[]", "{}", '["body"]', '["body", "marking", "rim"]', '["body", "body"]', "[" * 3000, '["\\u001b[2J"]')
    file.attrs["parts"] = texts[rng.integers(len(texts))]


def wrong_masks(file, place, rng):
    mask = taken(file, "symmetry_mask")
    at = int(rng.integers(len(mask)))
    kind = rng.integers(3)
    if kind == 0:
        mask[at, 0] = False
    elif kind == 1:
        mask[at] = False
    else:
        mask[:] = False
    file.create_dataset("symmetry_mask", data=mask, chunks=mask.shape, **_COMPRESSED)


def masks_of_other_bytes(file, place, rng):
    """Truth values that are neither 0 nor 1."""
    mask = file["symmetry_mask"]
    if mask.chunks:
        data = rng.integers(0, 256, mask.chunks, dtype=np.uint8).tobytes()
        raw = zlib.compress(data)
        mask.id.write_direct_chunk((0,) * mask.ndim, raw, 2)


def wrong_pixels(file, place, rng):
    name = str(rng.choice(["marking_pixels", "part_pixels"]))
    pixels = values_of(file, name)
    pixels[rng.integers(len(pixels)), ...] = [np.nan, np.inf, -1.0, 1e30, 1e-40][rng.integers(5)]
    del file[name]
    file.create_dataset(name, data=pixels, chunks=pixels.shape, **_COMPRESSED)


def wrong_ids(file, place, rng):
    ids = taken(file, "segmentation")
    ids[rng.integers(len(ids))] = int(rng.choice([0, 3, 255]))
    file.create_dataset("segmentation", data=ids, chunks=(1, *ids.shape[1:]), **_COMPRESSED)


def wrong_depths(file, place, rng):
    """Depths that are none, or in a set that has none."""
    ids = values_of(file, "segmentation")
    depth = values_of(file, "depth") if "depth" in file else (3.5 * (ids > 0)).astype("f4")
    depth[rng.integers(len(depth))] *= [np.nan, np.inf, -1, 0, 1][rng.integers(5)]
    if "depth" in file:
        del file["depth"]
    file.create_dataset("depth", data=depth, chunks=(1, *depth.shape[1:]), **_COMPRESSED)


VALUES = (
    wrong_rotations,
    wrong_rotations,
    no_group,
    odd_group,
    odd_parts,
    wrong_depths,
    wrong_masks,
    masks_of_other_bytes,
    wrong_pixels,
    wrong_ids,
)
