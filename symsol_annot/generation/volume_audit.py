"""Drawing rotations inside, outside and at the edge of a volume, to see whether they show nothing.

Whether something shows at a rotation is decided by points of the lattice, and membership by a region of directions that
is known on a grid. So near the region's edge, within a band that is stated here, the two may differ: these rotations
are counted, and are no faults.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from symsol_annot.annotation.volume import Volume
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.rotations.so3 import Angles, Rotations, rotations_about, uniform_rotations

EDGE_BAND_RAD = float(np.radians(4.0))  # of an image of 224 pixels; of a smaller one as the root of its size
DEFAULT_SIZE_PX = 224
INSIDE_PER_IMAGE, OUTSIDE_PER_IMAGE, EDGE_PER_IMAGE = 6, 6, 4
_TRIED = 64  # rotations, of which those in the band are taken


@dataclass(frozen=True)
class VolumeCounts:
    """What was drawn of one image's volume.

    Attributes:
        inside: how many rotations inside, beyond the band at the edge.
        outside: how many outside, beyond the band.
        edge: how many within the band.
        edge_otherwise: those of them that show something inside, or nothing outside.
        faults: what contradicts the volume, in words.
    """

    inside: int
    outside: int
    edge: int
    edge_otherwise: int
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class VolumeAudit:
    """Audits one volume.

    Attributes:
        volume: of rotations that show nothing.
        tolerance_px: T, the area in pixels that counts as nothing; None where nothing breaks the symmetry.
        size_px: the width of the images.
    """

    volume: Volume
    tolerance_px: float | None
    size_px: int

    @property
    def band_rad(self) -> float:
        """How far from the edge on either side drawing may decide otherwise."""
        return EDGE_BAND_RAD * max(1.0, float(np.sqrt(DEFAULT_SIZE_PX / self.size_px)))

    @cached_property
    def _rest(self) -> Volume | None:
        """All that is outside; None where nothing is."""
        return None if self.volume.mask.all() else Volume(~self.volume.mask)

    def to_edge(self, R_m2c: Rotations) -> Angles:
        """Return how far rotations (n, 3, 3) are from the volume's edge, in rad, negative inside: (n,)."""
        if self._rest is None:
            return np.full(len(R_m2c), -np.pi)
        return np.asarray(self.volume.distance(R_m2c) - self._rest.distance(R_m2c))

    def drawn(self, renderer: Renderer, rng: np.random.Generator) -> VolumeCounts:
        """Draw random rotations, and compare what they show with where they are."""
        R = np.concatenate([self.volume.sample(_TRIED, rng), uniform_rotations(_TRIED, rng), self._near_edge(rng)])
        to_edge = self.to_edge(R)
        chosen = [
            np.flatnonzero(to_edge < -self.band_rad)[:INSIDE_PER_IMAGE],
            np.flatnonzero(to_edge > self.band_rad)[:OUTSIDE_PER_IMAGE],
            np.flatnonzero(np.abs(to_edge) <= self.band_rad)[-EDGE_PER_IMAGE:],
        ]
        shows, is_inside = self.show(renderer, R[np.concatenate(chosen)]), to_edge[np.concatenate(chosen)] < 0
        inside, outside, edge = (len(some) for some in chosen)
        wrong, wrong_at_edge = np.split(shows == is_inside, [inside + outside])
        words = {True: "inside its volume shows a part", False: "outside its volume shows nothing"}
        beyond = zip(np.concatenate(chosen[:2]).tolist(), is_inside[: inside + outside].tolist(), wrong, strict=True)
        faults = [
            f"a rotation {np.degrees(abs(to_edge[row])):.1f} degrees {words[within]}"
            for row, within, is_wrong in beyond
            if is_wrong
        ]
        return VolumeCounts(inside, outside, edge, int(np.count_nonzero(wrong_at_edge)), tuple(faults))

    def show(self, renderer: Renderer, R_m2c: Rotations) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Tell which rotations (n, 3, 3) show something of a part that breaks the symmetry, by drawing: (n,)."""
        if self.tolerance_px is None:
            return np.zeros(len(R_m2c), dtype=bool)
        return np.asarray(renderer.marking_pixels(R_m2c) >= self.tolerance_px)

    def _near_edge(self, rng: np.random.Generator) -> Rotations:
        """Return rotations (n, 3, 3) on the way from some inside to others, few degrees from where they leave it."""
        if self._rest is None:
            return np.zeros((0, 3, 3))
        R = self.volume.sample(_TRIED, rng)
        axes = rng.normal(size=(_TRIED, 3))
        reach = self.band_rad * rng.random(_TRIED)
        turns = [rotations_about(axis, angle) for axis, angle in zip(axes, reach, strict=True)]
        near = np.concatenate([R, self._rest.sample(_TRIED, rng)]) @ np.concatenate([turns, turns])
        return near[np.abs(self.to_edge(near)) <= self.band_rad]
