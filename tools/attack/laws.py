"""What a loaded set must obey, whoever signed it. Shares no code with the package."""

import numpy as np

from attack.apart import SilentError

_OFF = 1e-6  # from SO(3), of float64 labels
_SAME = 1e-3  # of a group's entries: imported ones are fitted to float32
_PRODUCTS = 100


def check_labels(labels, *, has_marking):
    """Raise a SilentError where labels are none that a set can have."""
    _require(_are_rotations(labels.rotation), "rotation: not in SO(3)")
    check_group(labels.symmetry_group)
    images, order = len(labels.rotation), len(labels.symmetry_group)
    mask = labels.symmetry_mask
    _require(mask.dtype == bool and mask.shape == (images, order), f"symmetry_mask: {mask.dtype} of {mask.shape}")
    _require(mask[:, 0].all(), "symmetry_mask: a set lacks R_gt")
    _require(has_marking or mask.all(), "symmetry_mask: a body without marking has not its whole group")
    pixels = labels.marking_pixels
    _require(pixels.shape == (images,), "marking_pixels: not one per image")
    _require(not has_marking or bool(np.all(np.isfinite(pixels) & (pixels >= 0))), "marking_pixels: no area")
    parts = labels.part_pixels
    if parts is not None:
        _require(parts.shape == (images, 2 if has_marking else 1), f"part_pixels: of shape {parts.shape}")
        _require(bool(np.all(np.isfinite(parts) & (parts >= 0))), "part_pixels: no area")
        _require(not has_marking or bool(np.all(parts[:, 1] <= pixels)), "part_pixels: larger than marking_pixels")


def check_sample(sample, image_size, parts):
    """Raise a SilentError where a sample is none that a set can have."""
    width, height = image_size
    _require(sample.image.shape == (height, width, 3) and sample.image.dtype == np.uint8, "image: another shape")
    _require(_are_rotations(sample.rotation[None]), "rotation: not in SO(3)")
    if sample.segmentation is not None:
        _require(sample.segmentation.shape == (height, width), "segmentation: another shape")
        _require(sample.segmentation.max() <= 2, "segmentation: an id that there is not")
    if sample.depth is not None:
        _require(sample.depth.shape == (height, width) and sample.depth.dtype == np.float32, "depth: another shape")
    if sample.part_pixels is not None:
        _require(sample.part_pixels.shape == (parts,), "part_pixels: another count of parts")
    if sample.symmetry_mask is not None:
        _require(bool(sample.symmetry_mask[0]), "symmetry_mask: a set lacks R_gt")
        check_group(sample.symmetry_group)


def check_group(group):
    """Raise a SilentError where rotations are no group with the identity first."""
    _require(len(group) > 0 and _are_rotations(group), "symmetry_group: not in SO(3)")
    _require(np.abs(group[0] - np.eye(3)).max() < _SAME, "symmetry_group: the first is not the identity")
    chosen = np.random.default_rng(0).integers(len(group), size=(2, _PRODUCTS))
    products = group[chosen[0]] @ group[chosen[1]]
    off = np.abs(products[:, None] - group[None]).max(axis=(2, 3)).min(axis=1)
    _require(bool(off.max() < _SAME), "symmetry_group: no group: a product of two is not in it")


def check_rotations(R):
    """Raise a SilentError where matrices are no rotations, as closely as predictions have to be."""
    off = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(initial=0.0)
    _require(bool(off < _SAME and (np.linalg.det(R) > 0).all()), "rotations: not in SO(3)")


def check_same(found, expected, what):
    """Raise a SilentError where arrays or numbers are not the expected ones."""
    same = np.array_equal(np.asarray(found), np.asarray(expected), equal_nan=np.asarray(expected).dtype.kind == "f")
    _require(same, f"{what}: is not what the manifest's digests stand for")


def _are_rotations(R):
    R = np.asarray(R)
    if R.ndim != 3 or R.shape[1:] != (3, 3) or not np.isfinite(R).all():
        return False
    off = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max()
    return bool(off < _OFF and (np.linalg.det(R) > 0).all())


def _require(is_so, otherwise):
    if not is_so:
        raise SilentError(otherwise)
