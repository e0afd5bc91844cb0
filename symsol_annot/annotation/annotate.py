"""Symmetry sets: which of an image's candidate rotations draw that image (section 5.1.2, eqs. 5.1 to 5.4).

One rule, for every object. C is the body's symmetry group, H the marking's stabiliser within it, p(R) the
marking's visible area in pixels at R, and T the object's tolerance. A coset R H shows the marking where p reaches T
at one of its rotations:

    R_gt H shows it:    S = { R_gt g : g in H }
    R_gt H hides it:    S = { R_gt g : g in C, R_gt g H hides it }

A body without marking shows none anywhere, so S = { R_gt g : g in C }.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.scene import Renderer
from symsol_annot.rotations.so3 import Rotations


@dataclass(frozen=True, eq=False)
class Annotation:
    """One image's symmetry set over the candidates R_gt g.

    Attributes:
        mask: (G,) bool, which g of the body's group are in the set; S = R_gt @ symmetry_group[mask].
        candidate_pixels: (G,) f8, the largest p over the coset R_gt g H; NaN where the rule did not need it. Where
            geometry decided, an area on the same side of the tolerance, and 0 where p is 0.
    """

    mask: npt.NDArray[np.bool_]
    candidate_pixels: npt.NDArray[np.float64]


def coset_marking_px(
    spec: ObjectSpec,
    R_gt: Rotations,
    image_px: float,
    renderer: Renderer,
    visibility: MarkingVisibility | None = None,
) -> float:
    """Return the area in pixels by which an image's coset R_gt H shows the marking; a shard stores it.

    That is the image's own p(R_gt); but where it is below T and another rotation of the coset reaches T, the largest p
    of the coset: a rasteriser can give one of them a sample more.

    Args:
        spec: the object.
        R_gt: (3, 3) the image's rotation.
        image_px: p(R_gt), as the image shows it (`View.marking_pixels`).
        renderer: draws other rotations of the coset.
        visibility: decides most of them without drawing.
    """
    others = R_gt @ spec.stabiliser[1:]
    if spec.marking is None or is_shown(spec, image_px) or not len(others):
        return image_px
    if not is_shown(spec, _areas(spec, others, renderer, visibility)).any():
        return image_px
    return float(renderer.marking_pixels(others).max())


def is_shown(spec: ObjectSpec, pixels: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Tell where an area p in pixels counts as shown: p >= T, never for a body without marking."""
    tolerance_px = np.inf if spec.tolerance_px is None else spec.tolerance_px
    return np.asarray(np.asarray(pixels) >= tolerance_px)


def annotate(
    spec: ObjectSpec,
    R_gt: Rotations,
    coset_px: float,
    renderer: Renderer,
    visibility: MarkingVisibility | None = None,
) -> Annotation:
    """Return the symmetry set of the image at R_gt.

    Args:
        spec: the object.
        R_gt: (3, 3) the image's rotation.
        coset_px: by which its coset shows the marking, from `coset_marking_px`.
        renderer: draws the candidates, where the marking is hidden.
        visibility: decides most of them without drawing; the set is the same without it.
    """
    cosets = spec.cosets
    candidate_pixels = np.full(len(spec.symmetry_group), np.nan)
    if spec.marking is None:
        return Annotation(np.ones(len(spec.symmetry_group), dtype=bool), np.zeros_like(candidate_pixels))
    candidate_pixels[cosets[0]] = coset_px
    if is_shown(spec, coset_px):
        mask = np.zeros(len(candidate_pixels), dtype=bool)
        mask[cosets[0]] = True
        return Annotation(mask, candidate_pixels)
    others = cosets[1:]
    candidates = R_gt @ spec.symmetry_group[others.reshape(-1)]
    areas = _areas(spec, candidates, renderer, visibility).reshape(others.shape)
    candidate_pixels[others] = areas.max(axis=1, keepdims=True)
    return Annotation(~is_shown(spec, candidate_pixels), candidate_pixels)


def _areas(
    spec: ObjectSpec, R_m2c: Rotations, renderer: Renderer, visibility: MarkingVisibility | None
) -> npt.NDArray[np.float64]:
    """Return areas (n,) in pixels, from geometry where that decides, and drawn elsewhere."""
    if visibility is None or spec.marking is None:
        return renderer.marking_pixels(R_m2c)
    areas = visibility.areas(R_m2c, spec.marking.tolerance_px)
    undecided = np.isnan(areas)
    if undecided.any():
        areas[undecided] = renderer.marking_pixels(R_m2c[undecided])
    return areas
