"""The general rule for a ball: its candidates are all rotations, and its sets follow by families.

Which rotations draw an image depends on which of the parts that break SO(3) show in it:

    none:   a volume, of all rotations that show nothing; the same for every such image
    some:   the turns that keep each of these in place, as far as the others stay out of sight
    all:    the turns that keep all of them in place

A turn that keeps a part in place draws it alike, by geometry, so that of a candidate only the parts that do not show in
the image are asked about. `tools/prove_spherex.py` looks for other rotations that draw an image.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.balls.hidden_directions import hidden_volume
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.annotation.volume import Volume
from symsol_annot.objects.mesh import is_convex
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Areas = npt.NDArray[np.float64]

_AT_ONCE = 16  # candidates whose windows are held


@dataclass(frozen=True, eq=False)
class BallRule:
    """Finds the symmetry sets of one ball.

    Attributes:
        spec: the object, whose body every rotation maps onto itself.
        renderer: draws candidates.
        camera: what the object is seen through.
        settings: the lattice.
        exhaustive: draw every candidate, also where geometry decides; the sets are the same.
    """

    spec: ObjectSpec
    renderer: Renderer
    camera: Camera
    settings: RenderSettings
    exhaustive: bool = False

    @cached_property
    def volume(self) -> Volume | None:
        """All rotations that show nothing of the breaking parts; None where each shows something."""
        return hidden_volume(self.spec.mesh, self.camera, self.spec.tolerance_px, self.renderer)

    def part_pixels(self, R_m2c: Rotations) -> Areas:
        """Return the areas (n, B) in pixels of the breaking parts under rotations (n, 3, 3), drawn."""
        found = np.zeros((len(R_m2c), len(self.spec.mesh.breaking)))
        for start in range(0, len(R_m2c), _AT_ONCE):
            windows = self.renderer.label_windows(R_m2c[start : start + _AT_ONCE])
            for number, window in enumerate(windows, start=start):
                found[number] = [np.count_nonzero(window.ids == part) for part in self.spec.mesh.breaking]
        return found / self.settings.points_per_pixel

    def differing_px(self, R_gt: Rotations, own_px: Areas) -> Areas:
        """Return by how much each candidate of `symmetry_group` differs from an image that shows some part.

        Args:
            R_gt: (3, 3) the image's rotation.
            own_px: (B,) the area in pixels of each breaking part in the image.

        Returns:
            (G,) in pixels, the largest of a coset R_gt g H: 0 for certified symmetries, NaN where g moves a part that
            shows. Where geometry decides, an area on the same side of T, and 0 where it is 0.
        """
        cosets, group = self.spec.cosets, self.spec.symmetry_group
        found = np.full(len(group), np.nan)
        found[cosets[0]] = 0.0
        shows = own_px >= (self.spec.tolerance_px or np.inf)
        keeps_what_shows = np.asarray(self.spec.kept_by_turns)[shows].all(axis=0)
        others = cosets[1:][keeps_what_shows[cosets[1:, 0]]]
        candidates = R_gt @ group[others.reshape(-1)]
        found[others] = (
            self._hidden_px(candidates, ~shows).reshape(others.shape).max(axis=1, keepdims=True, initial=0.0)
        )
        return found

    def _hidden_px(self, candidates: Rotations, is_hidden: npt.NDArray[np.bool_]) -> Areas:
        """Return the areas (n,) in pixels under candidates (n, 3, 3) of the parts (B,) that the image hides."""
        areas = np.zeros(len(candidates))
        if not len(candidates):  # parts that no turn keeps in place
            return areas
        for place in np.flatnonzero(is_hidden).tolist():
            areas += self._areas_of(place, candidates)
        undecided = np.isnan(areas)
        if undecided.any():
            areas[undecided] = self.part_pixels(candidates[undecided])[:, is_hidden].sum(axis=1)
        return areas

    def _areas_of(self, place: int, candidates: Rotations) -> Areas:
        """Return areas (n,) of the breaking part of a place, NaN where geometry does not decide."""
        if self._by_part is None or self.spec.tolerance_px is None:
            return np.full(len(candidates), np.nan)
        return self._by_part[place].areas(candidates, self.spec.tolerance_px)

    @cached_property
    def _by_part(self) -> list[MarkingVisibility] | None:
        """What decides by geometry how much shows of each breaking part; None where nothing does."""
        mesh = self.spec.mesh
        if self.exhaustive or not is_convex(mesh):
            return None
        return [
            MarkingVisibility(replace(mesh, breaking=(part,)), self.camera, self.settings) for part in mesh.breaking
        ]
