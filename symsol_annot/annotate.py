"""Symmetry sets: which of an image's candidate rotations draw that image (section 5.1.2, eqs. 5.1 to 5.4).

One rule, for every object. C is the body's symmetry group, H the marking's stabiliser within it, p(R) the
marking's visible area in pixels at R, the largest over the coset R H, and T the object's tolerance:

    p(R_gt) >= T, the marking shows:    S = { R_gt g : g in H }
    p(R_gt) <  T, it is hidden:         S = { R_gt g : g in C, p(R_gt g) < T }

A body without marking shows none anywhere, so S = { R_gt g : g in C }.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.objects import ObjectSpec
from symsol_annot.scene import Renderer
from symsol_annot.so3 import Rotations
from symsol_annot.visibility import MarkingVisibility


@dataclass(frozen=True, eq=False)
class Annotation:
    """One image's symmetry set over the candidates R_gt g.

    Attributes:
        mask: (G,) bool, which g of the body's group are in the set; S = R_gt @ symmetry_group[mask].
        candidate_pixels: (G,) f8, p(R_gt g); NaN where the rule did not need it. Where geometry decided, an area on the
            same side of the tolerance, and 0 where p is 0.
    """

    mask: npt.NDArray[np.bool_]
    candidate_pixels: npt.NDArray[np.float64]


def marking_pixels(spec: ObjectSpec, R_gt: Rotations, renderer: Renderer) -> float:
    """Return p(R_gt) in pixels: the largest visible area of the marking over the coset R_gt H; 0 without a marking."""
    return float(renderer.marking_pixels(R_gt @ spec.stabiliser).max()) if spec.marking else 0.0


def is_shown(spec: ObjectSpec, pixels: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """Tell where an area p in pixels counts as shown: p >= T, never for a body without marking."""
    tolerance_px = spec.marking.tolerance_px if spec.marking else np.inf
    return np.asarray(np.asarray(pixels) >= tolerance_px)


def annotate(
    spec: ObjectSpec,
    R_gt: Rotations,
    pixels: float,
    renderer: Renderer,
    visibility: MarkingVisibility | None = None,
) -> Annotation:
    """Return the symmetry set of the image at R_gt.

    Args:
        spec: the object.
        R_gt: (3, 3) the image's rotation.
        pixels: p(R_gt), from `marking_pixels`.
        renderer: draws the candidates, where the marking is hidden.
        visibility: decides most of them without drawing; the set is the same without it.
    """
    cosets = spec.cosets
    candidate_pixels = np.full(len(spec.symmetry_group), np.nan)
    if spec.marking is None:
        return Annotation(np.ones(len(spec.symmetry_group), dtype=bool), np.zeros_like(candidate_pixels))
    candidate_pixels[cosets[0]] = pixels
    if is_shown(spec, pixels):
        mask = np.zeros(len(candidate_pixels), dtype=bool)
        mask[cosets[0]] = True
        return Annotation(mask, candidate_pixels)
    others = cosets[1:]
    candidates = R_gt @ spec.symmetry_group[others]  # (cosets, H, 3, 3)
    areas = np.full(others.shape, np.nan)
    if visibility is not None:
        areas = visibility.areas(candidates.reshape(-1, 3, 3), spec.marking.tolerance_px).reshape(others.shape)
    undecided = np.isnan(areas).any(axis=1)
    areas[undecided] = renderer.marking_pixels(candidates[undecided].reshape(-1, 3, 3)).reshape(-1, others.shape[1])
    candidate_pixels[others] = areas.max(axis=1, keepdims=True)
    return Annotation(~is_shown(spec, candidate_pixels), candidate_pixels)
