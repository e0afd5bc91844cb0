"""The general rule: which candidates R_gt g draw an image, decided by comparing images (format version 2 of objects).

A certified symmetry of the whole object, parts included, is a member, undrawn. Every other candidate is compared with
the image at the points of the lattice where either shows a part that breaks the body's symmetry: in the part that is
seen there, and in its shade. It is a member where fewer than T pixels of points differ. The body is not compared with
itself: it is the same by its group.

On a circle, which its steps only sample, the set is the continuous limit's. An image that shows a part has no
neighbours in it that differ from it by less than the lattice can tell: there a member also has to have what
`continuous_limit` asks for.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.continuous_limit import have_the_same, what_is_seen
from symsol_annot.annotation.deciding import Visibility
from symsol_annot.annotation.symmetry_set import circles_of
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import LitWindow, Renderer
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Areas = npt.NDArray[np.float64]

SHADE_LEVELS = 12  # of 255, beyond which two shades are not the same
_AT_ONCE = 16  # candidates whose windows are held


@dataclass(frozen=True, eq=False)
class GeneralRule:
    """Compares images of one object.

    Attributes:
        spec: the object, which has parts that break its symmetry.
        renderer: draws candidates.
        camera: what the object is seen through.
        settings: the lattice.
        visibility: tells by geometry where parts show or hide; the sets are the same without it.
        exhaustive: draw and compare every candidate, also where counting points decides; the sets are the same.
    """

    spec: ObjectSpec
    renderer: Renderer
    camera: Camera
    settings: RenderSettings
    visibility: Visibility | None = None
    exhaustive: bool = False

    def shown_px(self, part_pixels: Areas) -> float:
        """Return the largest area in pixels of a breaking part, given each part's (P,)."""
        return float(part_pixels[np.array(self.spec.mesh.breaking) - 1].max())

    def differing_px(self, R_gt: Rotations) -> Areas:
        """Return by how much each candidate differs from the image at R_gt (3, 3).

        Returns:
            (G,) in pixels, the largest of a coset R_gt g H: 0 for certified symmetries, NaN where the continuous limit
            refuses a candidate. Where counting points decides, an area on the same side of T, and 0 where it is 0.
        """
        cosets, group = self.spec.cosets, self.spec.symmetry_group
        found = np.full(len(group), np.nan)
        found[cosets[0]] = 0.0
        others = cosets[1:]
        own_px = float(self.renderer.marking_pixels(R_gt[None])[0])
        image = self.renderer.lit_windows(R_gt[None])[0] if own_px > 0 or self.exhaustive else None
        if image is not None and self._is_shown(own_px) and circles_of(group) is not None:
            seen = what_is_seen(self.spec.mesh, R_gt, image, self.camera.lattice(self.settings.samples_per_axis))
            others = others[have_the_same(self.spec.mesh, seen, group[others[:, 0]])]
        candidates = R_gt @ group[others.reshape(-1)]
        areas = self._areas(candidates, own_px, image).reshape(others.shape)
        found[others] = areas.max(axis=1, keepdims=True, initial=0.0)
        return found

    def between(self, R_m2c: Rotations, others: Rotations) -> Areas:
        """Return by how many pixels of points the image at R_m2c (3, 3) differs from each at others (n, 3, 3): (n,)."""
        return self._compared(self.renderer.lit_windows(R_m2c[None])[0], others)

    def _is_shown(self, area_px: float) -> bool:
        return area_px >= (self.spec.tolerance_px or np.inf)

    def _areas(self, candidates: Rotations, own_px: float, image: LitWindow | None) -> Areas:
        """Return how much candidates (n, 3, 3) differ, drawing those alone that counts of points leave open."""
        if self.exhaustive and image is not None:
            return self._compared(image, candidates)
        if image is None:
            return self._hidden_areas(candidates)
        areas = np.abs(self.renderer.marking_pixels(candidates) - own_px)
        is_open = areas < (self.spec.tolerance_px or 0.0)
        areas[is_open] = self._compared(image, candidates[is_open])
        return areas

    def _hidden_areas(self, candidates: Rotations) -> Areas:
        """Return how much breaking parts show: from an image that shows nothing of them, candidates differ by that."""
        if self.visibility is None or self.spec.tolerance_px is None:
            return self.renderer.marking_pixels(candidates)
        areas = self.visibility.areas(candidates, self.spec.tolerance_px)
        undecided = np.isnan(areas)
        if undecided.any():
            areas[undecided] = self.renderer.marking_pixels(candidates[undecided])
        return areas

    def _compared(self, image: LitWindow, candidates: Rotations) -> Areas:
        counts = np.zeros(len(candidates))
        for start in range(0, len(candidates), _AT_ONCE):
            windows = self.renderer.lit_windows(candidates[start : start + _AT_ONCE])
            for number, window in enumerate(windows, start=start):
                counts[number] = differing_points(image, window, self.spec.mesh.breaking)
        return counts / self.settings.points_per_pixel


def differing_points(image: LitWindow, other: LitWindow, breaking: tuple[int, ...]) -> int:
    """Return at how many points of the lattice two images differ, of those where either shows a breaking part.

    Args:
        image: all points around the breaking parts of one.
        other: those of the other.
        breaking: the ids of these parts.
    """
    breaks, other_breaks = np.isin(image.ids, breaking), np.isin(other.ids, breaking)
    count = int(np.count_nonzero(breaks)) + int(np.count_nonzero(other_breaks))
    common = image.window.within(other.window)
    if common is None:
        return count
    here, there = common.seen_from(image.window).slices, common.seen_from(other.window).slices
    breaks, other_breaks = breaks[here], other_breaks[there]
    either = breaks | other_breaks
    shades = np.abs(image.rgb[here][either].astype(np.int16) - other.rgb[there][either]).max(axis=-1, initial=0)
    differs = (image.ids[here][either] != other.ids[there][either]) | (shades > SHADE_LEVELS)
    return count - int(np.count_nonzero(breaks)) - int(np.count_nonzero(other_breaks)) + int(np.count_nonzero(differs))
