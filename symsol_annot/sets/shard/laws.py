"""What the labels of a shard must obey, whatever its checksums say: rotations, a group, R_gt in every set, the rule.

`load` refuses a shard that breaks a law, `verify` lists all that it breaks.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import first_of
from symsol_annot.rendering.renderer import BODY, MARKING
from symsol_annot.rotations.group_laws import check_group, faults_of_elements, right_products
from symsol_annot.rotations.so3 import ORTHONORMAL_TOLERANCE, rotation_deviation
from symsol_annot.sets.shard.reader import Shard, ShardLabels
from symsol_annot.sets.stated.equality import Equality

Flags = npt.NDArray[np.bool_]
Images = Callable[[Flags], str]
_LISTED_ROWS = 5
_ROUNDING = 1e-6  # of sums of float32
_PRODUCT_TOLERANCE = 1e-6
_IMPORTED_PRODUCT_TOLERANCE = 2e-4  # whose groups come from float32


def label_faults(shard: Shard, labels: ShardLabels) -> Iterator[str]:
    """Yield what the labels of no image set can be, one line each.

    Args:
        shard: whose they are; its arrays are not read.
        labels: as `Shard.labels` gives them.
    """

    def images(bad: Flags) -> str:
        return f"image {first_of([str(shard.first_index + int(row)) for row in np.flatnonzero(bad)], _LISTED_ROWS)}"

    if labels.rotation is not None:
        no_rotation = ~(rotation_deviation(labels.rotation) <= ORTHONORMAL_TOLERANCE)
        if no_rotation.any():
            yield f"rotation: {images(no_rotation)}: is no rotation (R^T R = I, det R = 1 to {ORTHONORMAL_TOLERANCE:g})"
    yield from _area_faults(shard, labels, images)
    tolerance = _IMPORTED_PRODUCT_TOLERANCE if shard.is_imported else _PRODUCT_TOLERANCE
    is_list = shard.equality is not None and shard.equality.has_all_rotations
    faults = (
        faults_of_elements(labels.symmetry_group) if is_list else check_group(labels.symmetry_group, tolerance).faults
    )
    yield from (f"symmetry_group: {fault}" for fault in faults)
    if labels.symmetry_mask is None:
        return
    has_own = labels.symmetry_mask[:, 0]
    if not has_own.all():
        yield f"symmetry_mask: {images(~has_own)}: the set lacks R_gt, the image's own rotation"
    elif not faults:
        if shard.equality is not None:
            yield from _closure_faults(labels, labels.symmetry_mask, shard.equality, tolerance, images)
            if labels.volume is not None:
                yield from _volume_faults(labels, labels.volume, shard, images)
        else:
            yield from _mask_faults(labels, labels.symmetry_mask, shard.tolerance_px, tolerance, images)


def stabiliser_of(shard: Shard, labels: ShardLabels) -> Flags | None:
    """Return which (G,) symmetries map the marking onto itself: the one set of all images that show it.

    Returns:
        None where no image shows a marking, no image has a set, or those that show it differ, which is a fault; and for
        an object of format version 2, whose images that show a part can have different sets.
    """
    if labels.symmetry_mask is None or labels.marking_pixels is None or math.isnan(shard.tolerance_px):
        return None
    if shard.equality is not None:
        return None
    sets = labels.symmetry_mask[labels.marking_pixels >= shard.tolerance_px]
    return sets[0] if len(sets) and (sets == sets[0]).all() else None


def _area_faults(shard: Shard, labels: ShardLabels, images: Images) -> Iterator[str]:
    """Yield which areas no image can have."""
    marking, parts = labels.marking_pixels, labels.part_pixels
    if marking is not None:
        no_area = ~(np.isfinite(marking) & (marking >= 0))
        if no_area.any():
            yield f"marking_pixels: {images(no_area)}: is no area"
    if marking is None or parts is None:
        return
    no_area = ~(np.isfinite(parts) & (parts >= 0)).all(axis=1)
    if no_area.any():
        yield f"part_pixels: {images(no_area)}: is no area"
        return
    too_large = parts.sum(axis=1, dtype=np.float64) > shard.most_pixels * (1 + _ROUNDING)
    if too_large.any():
        yield f"part_pixels: {images(too_large)}: is more than the {shard.most_pixels:g} pixels of an image"
    if shard.equality is not None:
        breaking = np.array(shard.equality.breaking, dtype=int) - BODY
        other = (marking >= 0) & (marking != parts[:, breaking].max(axis=1, initial=0.0))
        if other.any():
            what = "is not the largest of part_pixels of the parts that break the symmetry"
            yield f"marking_pixels: {images(other)}: {what}"
        return
    too_small = (marking >= 0) & (marking < parts[:, MARKING - 1]) if parts.shape[1] >= MARKING else np.zeros(0, bool)
    if too_small.any():
        yield f"marking_pixels: {images(too_small)}: is less than the marking's part_pixels"


def _closure_faults(
    labels: ShardLabels, mask: Flags, equality: Equality, product_tolerance: float, images: Images
) -> Iterator[str]:
    """Yield why sets, each with its R_gt, are not the general rule's: with a member, what is certified alike."""
    stabiliser = np.array(equality.stabiliser)
    if stabiliser[-1] >= len(labels.symmetry_group):
        yield f"equality: the stabiliser has symmetry {stabiliser[-1]} of {len(labels.symmetry_group)}"
        return
    check = check_group(labels.symmetry_group[stabiliser], product_tolerance)
    if check.faults:
        yield f"equality: the stabiliser: {check.faults[0]}"
        return
    for generator in stabiliser[check.generators]:
        torn = (mask[:, right_products(labels.symmetry_group, int(generator))] != mask).any(axis=1)
        if torn.any():
            yield (
                f"symmetry_mask: {images(torn)}: the set lacks a rotation that differs from a member by one that maps "
                "each part onto itself"
            )
            return


def _volume_faults(labels: ShardLabels, volume: npt.NDArray[np.int32], shard: Shard, images: Images) -> Iterator[str]:
    """Yield why the volumes of sets, whose masks are lawful, are not the rule's: that of images which show nothing."""
    none_such = (volume < -1) | (volume >= len(labels.volumes))
    if none_such.any():
        yield f"volume: {images(none_such)}: is not among the {len(labels.volumes)} volumes, and not -1"
        return
    if len(np.unique(volume[volume >= 0])) < len(labels.volumes):
        yield "volumes: one of them belongs to no image"
    if labels.marking_pixels is None or shard.equality is None or labels.symmetry_mask is None:
        return
    shown = labels.marking_pixels >= shard.tolerance_px  # never where that is NaN
    if (volume[shown] >= 0).any():
        yield f"volume: {images(shown & (volume >= 0))}: shows a part that breaks the symmetry, and yet has a volume"
    if len(np.unique(volume[~shown])) > 1:
        yield "volume: images that show nothing have different volumes"
    has_more = ~shown & (labels.symmetry_mask.sum(axis=1) > len(shard.equality.stabiliser))
    if has_more.any():
        yield f"symmetry_mask: {images(has_more)}: shows nothing, and has members beside R_gt and its volume"
    is_bare = math.isnan(shard.tolerance_px)
    if is_bare and not ((volume >= 0).all() and all(found.measure == 1.0 for found in labels.volumes)):
        yield "volumes: a ball without parts that break its symmetry has all rotations"


def _mask_faults(
    labels: ShardLabels, mask: Flags, tolerance_px: float, product_tolerance: float, images: Images
) -> Iterator[str]:
    """Yield why sets, each with its R_gt, are not the one rule's over a group."""
    if labels.marking_pixels is None or math.isnan(tolerance_px):
        if not mask.all():
            yield f"symmetry_mask: {images(~mask.all(axis=1))}: a body without marking has its whole group"
        return
    shown = labels.marking_pixels >= tolerance_px
    if not shown.any():
        return
    stabiliser = mask[shown][0]
    if (mask[shown] != stabiliser).any():
        yield "symmetry_mask: images that show the marking have different sets, expected the stabiliser in each"
        return
    check = check_group(labels.symmetry_group[stabiliser], product_tolerance)
    if check.faults:
        yield f"symmetry_mask: the set of images that show the marking: {check.faults[0]}"
        return
    for generator in np.flatnonzero(stabiliser)[check.generators]:
        torn = (mask[:, right_products(labels.symmetry_group, int(generator))] != mask).any(axis=1)
        if torn.any():
            yield (
                f"symmetry_mask: {images(torn)}: the set lacks a rotation that differs from a member by one that maps "
                "the marking onto itself"
            )
            return
