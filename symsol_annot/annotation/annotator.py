"""The rule: which of an image's candidate rotations draw that image (section 5.1.2, eqs. 5.1 to 5.4).

One rule, for every object. C is the body's symmetry group, H the marking's stabiliser within it, p(R) the
marking's visible area in pixels at R, and T the object's tolerance. A coset R H shows the marking where p reaches T
at one of its rotations:

    R_gt H shows it:    S = { R_gt g : g in H }
    R_gt H hides it:    S = { R_gt g : g in C, R_gt g H hides it }

A body without marking shows none anywhere, so S = { R_gt g : g in C }. Objects of format version 2, with parts of any
kind, have the rule of `general_rule`, and balls with parts that of `ball_rule`, whose sets can have volume.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.balls.ball_rule import BallRule
from symsol_annot.annotation.deciding import Visibility, visibility_of
from symsol_annot.annotation.general_rule import GeneralRule
from symsol_annot.annotation.volume import Volume
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Renderer, View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations


@dataclass(frozen=True, eq=False)
class Annotation:
    """One image's symmetry set over the candidates R_gt g.

    Attributes:
        mask: (G,) bool, which g of the body's group are in the set; S = R_gt @ symmetry_group[mask].
        candidate_px: (G,) f8, the largest p in pixels over the coset R_gt g H; NaN where the rule did not need it.
            Where geometry decided, an area on the same side of the tolerance, and 0 where p is 0. By the general rule,
            the area in which the candidate differs from the image.
        volume: the part of SO(3) that the set fills besides; None for a set of measure zero.
    """

    mask: npt.NDArray[np.bool_]
    candidate_px: npt.NDArray[np.float64]
    volume: Volume | None = None


@dataclass(frozen=True, eq=False)
class Annotator:
    """Applies the rule to images of one object.

    Attributes:
        spec: the object.
        renderer: draws candidates.
        visibility: decides most of them without drawing; the sets are the same without it.
        general_rule: compares images; None for an object of format version 1.
        ball_rule: finds the sets of a ball with parts; None for any other object.
    """

    spec: ObjectSpec
    renderer: Renderer
    visibility: Visibility | None = None
    general_rule: GeneralRule | None = None
    ball_rule: BallRule | None = None

    @classmethod
    def for_object(
        cls,
        spec: ObjectSpec,
        camera: Camera,
        settings: RenderSettings,
        renderer: Renderer,
        *,
        exhaustive: bool = False,
    ) -> "Annotator":
        """Return what annotates an object's images by its rule.

        Args:
            spec: the object.
            camera: what it is seen through.
            settings: how it is drawn.
            renderer: draws candidates.
            exhaustive: draw every candidate, also where geometry decides; the sets are the same.
        """
        if spec.has_all_rotations:
            general = GeneralRule(spec, renderer, camera, settings, exhaustive=exhaustive)
            ball = BallRule(spec, renderer, camera, settings, exhaustive)
            return cls(spec, renderer, None, general, ball)
        visibility = None if exhaustive else visibility_of(spec, camera, settings)
        if not spec.has_general_rule:
            return cls(spec, renderer, visibility)
        rule = GeneralRule(spec, renderer, camera, settings, visibility, exhaustive)
        return cls(spec, renderer, visibility, rule)

    def shown_px(self, R_gt: Rotations, view: View) -> float:
        """Return the area in pixels by which an image counts as showing its marking; a shard stores it.

        By the general rule it is that of the breaking part that shows most; else that of `coset_px`.

        Args:
            R_gt: (3, 3) the image's rotation.
            view: the image.
        """
        if self.general_rule is None:
            return self.coset_px(R_gt, view.marking_pixels)
        return 0.0 if self.spec.marking is None else self.general_rule.shown_px(view.part_pixels)

    def is_shown(self, area_px: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Tell where an area p in pixels counts as shown: p >= T, never for a body without marking."""
        tolerance_px = np.inf if self.spec.tolerance_px is None else self.spec.tolerance_px
        return np.asarray(np.asarray(area_px) >= tolerance_px)

    def coset_px(self, R_gt: Rotations, view_px: float) -> float:
        """Return the area in pixels by which an image's coset R_gt H shows the marking; a shard stores it.

        That is the image's own p(R_gt); but where it is below T and another rotation of the coset reaches T, the
        largest p of the coset: a rasteriser can count one more lattice point at one of them.

        Args:
            R_gt: (3, 3) the image's rotation.
            view_px: p(R_gt), as the image itself shows it.
        """
        others = R_gt @ self.spec.stabiliser[1:]
        if self.spec.marking is None or self.is_shown(view_px) or not len(others):
            return view_px
        if not self.is_shown(self._areas_px(others)).any():
            return view_px
        return float(self.renderer.marking_pixels(others).max())

    def annotate(self, R_gt: Rotations, coset_px: float, view: View | None = None) -> Annotation:
        """Return the symmetry set of the image at R_gt.

        Args:
            R_gt: (3, 3) the image's rotation.
            coset_px: by which its coset shows the marking, in pixels, from `shown_px`.
            view: the image; it spares drawing it again where a rule asks which parts it shows.
        """
        if self.ball_rule is not None:
            return self._annotate_ball(self.ball_rule, R_gt, coset_px, view)
        cosets, order = self.spec.cosets, len(self.spec.symmetry_group)
        if self.spec.marking is None:
            return Annotation(np.ones(order, dtype=bool), np.zeros(order))
        if self.general_rule is not None:
            differing_px = self.general_rule.differing_px(R_gt)
            return Annotation(differing_px < self.spec.marking.tolerance_px, differing_px)
        candidate_px = np.full(order, np.nan)
        candidate_px[cosets[0]] = coset_px
        if self.is_shown(coset_px):
            mask = np.zeros(order, dtype=bool)
            mask[cosets[0]] = True
            return Annotation(mask, candidate_px)
        others = cosets[1:]
        candidates = R_gt @ self.spec.symmetry_group[others.reshape(-1)]
        candidate_px[others] = self._areas_px(candidates).reshape(others.shape).max(axis=1, keepdims=True)
        return Annotation(~self.is_shown(candidate_px), candidate_px)

    def _annotate_ball(self, rule: BallRule, R_gt: Rotations, coset_px: float, view: View | None) -> Annotation:
        """Return the symmetry set of the image of a ball."""
        if not self.is_shown(coset_px):
            differing_px = np.full(len(self.spec.symmetry_group), np.nan)
            differing_px[self.spec.cosets[0]] = 0.0
            return Annotation(differing_px == 0.0, differing_px, rule.volume)
        breaking = np.array(self.spec.mesh.breaking) - 1
        own_px = rule.part_pixels(R_gt[None])[0] if view is None else view.part_pixels[breaking]
        differing_px = rule.differing_px(R_gt, own_px)
        return Annotation(differing_px < (self.spec.tolerance_px or 0.0), differing_px)

    def _areas_px(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return areas (n,) in pixels, from geometry where that decides, and drawn elsewhere."""
        if self.visibility is None or self.spec.marking is None:
            return self.renderer.marking_pixels(R_m2c)
        areas_px = self.visibility.areas(R_m2c, self.spec.marking.tolerance_px)
        undecided = np.isnan(areas_px)
        if undecided.any():
            areas_px[undecided] = self.renderer.marking_pixels(R_m2c[undecided])
        return areas_px
