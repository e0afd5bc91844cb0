"""Drawing images of a set again, to see that its symmetry sets are what the pictures say.

Of each audited image some candidates R_gt g are drawn, half of them where the set ends: members next to candidates
that were rejected, and the other way round. Of an object of format version 2, candidates are compared with the image as
they were when the set was made: at all points of the lattice. Drawn as well are rotations that the object does not
declare: those of the group that is found from its mesh, and random ones near members. Of a set that fills a volume,
random rotations are drawn that are inside, outside and at the edge.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.symmetry_set import SymmetrySet
from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.generation.marking_trace import MarkingTrace
from symsol_annot.generation.outside import near_members
from symsol_annot.generation.volume_audit import VolumeAudit
from symsol_annot.rendering.control import ControlledRenderer
from symsol_annot.rendering.engines import engine_named
from symsol_annot.rendering.renderer import BACKGROUND, MARKING, Renderer
from symsol_annot.rotations.so3 import Rotations, angle_between
from symsol_annot.sets.dataset import Dataset, Sample
from symsol_annot.sets.plan import SetPlan

EDGE_AREA_PX = 1.0  # of breaking parts that another driver can draw otherwise, in pixels of the lattice's points
EDGE_PIXELS = 8  # how many pixels two drawings of one view may differ in: vertices round to other sub-pixels
RGB_LEVELS = 12  # how far a pixel must be off to count; a lattice point is worth a 16th to a quarter of the contrast
DEPTH_RADII = 0.02  # how far a depth must be off to count, in bounding-sphere radii; what an edge decides, by far more
CANDIDATES_PER_IMAGE = 24
OUTSIDE_PER_IMAGE, NEAR_PER_IMAGE = 8, 4  # rotations outside of the declared group
NEAR_RAD = np.radians(15.0)  # so far a candidate may be that draws a marking of a pixel or two the same
_POINTS_PER_PIXEL = 4  # of the lattice; each of a marking below the tolerance can colour a pixel


@dataclass
class AuditReport:
    """What an audit saw.

    Attributes:
        images: how many images were drawn again.
        members: how many members of their sets were drawn.
        rejected: how many rejected candidates were drawn.
        near_neighbours: of images that show the marking: rejected candidates that draw the same pixels. The set
            is the answer of the continuous limit; these show how far a pixel grid falls short of it.
        outside: how many rotations outside of the declared group were drawn, of groups that the mesh was found to have.
        near_members: how many random rotations near members were drawn.
        near_members_alike: those of them that draw the same pixels: the pixel grid is too coarse for them.
        within_tolerance: candidates whose marking shows, but by less than the tolerance.
        inside: how many random rotations were drawn that are inside a volume, beyond a band at its edge.
        beyond: how many that are outside, beyond the band.
        at_edge: how many that are in the band.
        at_edge_otherwise: those of them that show something inside, or nothing outside: the pixel grid decides there.
        faults: what contradicts the set, one line each.
    """

    images: int = 0
    members: int = 0
    rejected: int = 0
    near_neighbours: int = 0
    outside: int = 0
    near_members: int = 0
    near_members_alike: int = 0
    within_tolerance: int = 0
    inside: int = 0
    beyond: int = 0
    at_edge: int = 0
    at_edge_otherwise: int = 0
    faults: list[str] = field(default_factory=list)


def audit(
    dataset: Dataset,
    plan: SetPlan,
    renderer: Renderer,
    count: int,
    rng: np.random.Generator,
    on_image: Callable[[], object] = lambda: None,
    outside: Rotations | None = None,
) -> AuditReport:
    """Draw random images of a split again, each with up to 24 of its candidates, and compare them with their sets.

    Args:
        dataset: the split.
        plan: the one that the set was made by, from `plan_behind`; it gives the object and its colours.
        renderer: draws the plan's object through the plan's camera.
        count: how many images; all of a split that has fewer.
        rng: chooses images and candidates.
        on_image: called after each image.
        outside: (n, 3, 3) rotations g that the object's group lacks, from `found_outside`; some are drawn per image.

    Raises:
        NotAnnotatedError: the split has no symmetry sets.
        DataError: the set was imported.
        SettingsError: the plan's colours do not tell a pixel with some marking from one without.
        RenderError: the renderer failed, or draws otherwise than at its start.
    """
    if not dataset.is_annotated:
        raise NotAnnotatedError(f"{dataset.folder}: the split {dataset.split!r} has no symmetry sets to audit")
    report = AuditReport()
    controlled = ControlledRenderer(renderer)
    annotator = Annotator.for_object(plan.spec, plan.camera, plan.settings, controlled, exhaustive=True)
    drawer = _Drawer(annotator, None if plan.spec.has_general_rule else MarkingTrace(plan.settings))
    for row in np.sort(rng.choice(len(dataset), size=min(count, len(dataset)), replace=False)):
        sample = dataset[int(row)]
        _audit_image(sample, drawer, rng, report)
        if sample.volume is not None:
            _audit_volume(sample, sample.volume, drawer, rng, report)
        else:
            _audit_outside(sample, drawer, np.zeros((0, 3, 3)) if outside is None else outside, rng, report)
        report.images += 1
        on_image()
    controlled.check()
    return report


def _audit_image(sample: Sample, drawer: "_Drawer", rng: np.random.Generator, report: AuditReport) -> None:
    """Draw one image and some of its candidates again, and add what was seen to the report."""
    if sample.segmentation is None or sample.marking_visible is None:
        raise DataError("an imported set cannot be audited: how its images were drawn is not known")
    stored = drawer.drawing(sample.image, sample.segmentation, sample.depth, sample.marking_pixels)
    found = _faults_of_member(stored, drawer.draw(sample.rotation))
    report.faults += [f"image {sample.index}, drawn again at its own rotation: {what}" for what in found]
    symmetry_set = sample.symmetry_set
    candidates = symmetry_set.candidates
    chosen = _chosen(symmetry_set, rng) if sample.volume is None else np.flatnonzero(symmetry_set.is_member)
    for index in chosen:
        drawn = drawer.draw(candidates[index])
        differing_px = drawer.differing_px(sample.rotation, candidates[index])
        report.within_tolerance += int(drawn.coset_px > 0 and not drawn.shows)
        if symmetry_set.is_member[index]:
            report.members += 1
            found = [
                f"member {index} of its set: {what}" for what in drawer.faults_of_member(stored, drawn, differing_px)
            ]
        else:
            report.rejected += 1
            is_same = stored.draws_the_marking_of(drawn, differing_px, drawer.annotator.spec.tolerance_px)
            is_near = is_same and stored.shows and _angle_to_members_rad(symmetry_set, index) <= NEAR_RAD
            report.near_neighbours += int(is_near)
            found = [f"candidate {index} was rejected, but draws the same marking"] if is_same and not is_near else []
        report.faults += [f"image {sample.index}, {what}" for what in found]


def _audit_volume(
    sample: Sample, volume: Volume, drawer: "_Drawer", rng: np.random.Generator, report: AuditReport
) -> None:
    """Draw rotations inside, outside and at the edge of an image's volume, and report those that belong elsewhere."""
    audited = drawer.audit_of(volume, sample.image.shape[1])
    found = audited.drawn(drawer.annotator.renderer, rng)
    report.inside += found.inside
    report.beyond += found.outside
    report.at_edge += found.edge
    report.at_edge_otherwise += found.edge_otherwise
    report.faults += [f"image {sample.index}: {fault}" for fault in found.faults]
    off_rad = float(audited.to_edge(sample.rotation[None])[0])
    if off_rad > audited.band_rad:
        report.faults.append(f"image {sample.index}: its rotation is {np.degrees(off_rad):.1f} degrees off its volume")


def _audit_outside(
    sample: Sample, drawer: "_Drawer", outside: Rotations, rng: np.random.Generator, report: AuditReport
) -> None:
    """Draw rotations that are no candidates of the image, and report those that draw the image."""
    chosen = outside[rng.permutation(len(outside))[:OUTSIDE_PER_IMAGE]]
    for g in chosen:
        report.outside += 1
        if drawer.draws(sample, sample.rotation @ g):
            turn = np.degrees(float(angle_between(g, np.eye(3))))
            report.faults.append(
                f"image {sample.index}: a turn by {turn:.4g} degrees draws the same image, and is a symmetry found "
                "from the mesh that the object does not declare: its symmetry sets lack members"
            )
    for R_m2c in near_members(sample.symmetry_set, NEAR_PER_IMAGE, rng):
        report.near_members += 1
        report.near_members_alike += int(drawer.draws(sample, R_m2c))


@dataclass(frozen=True)
class _Drawing:
    """A view's pictures, and by how much its coset shows the marking.

    Attributes:
        rgb: (H, W, 3) u8.
        segmentation: (H, W) u8.
        depth: (H, W) f4; None where the set has none.
        trace: (H, W) bool, where the RGB carries the marking's colour; nowhere, where images are compared whole.
        coset_px: the marking's area in pixels, by the rule.
        shows: whether that counts as shown.
    """

    rgb: npt.NDArray[np.uint8]
    segmentation: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32] | None
    trace: npt.NDArray[np.bool_]
    coset_px: float
    shows: bool

    def draws_the_marking_of(self, other: "_Drawing", differing_px: float | None, tolerance_px: float | None) -> bool:
        """Tell whether both hide the marking, or both show it in the very same pixels; or differ by less than T.

        Args:
            other: the drawing of a candidate.
            differing_px: by how much it differs, by the general rule; None where that is not the set's.
            tolerance_px: T.
        """
        if differing_px is not None:
            return differing_px < (tolerance_px or np.inf)
        if not self.shows or not other.shows:
            return self.shows == other.shows
        same_ids = np.array_equal(self.segmentation == MARKING, other.segmentation == MARKING)
        return same_ids and np.array_equal(self.trace, other.trace)


@dataclass(frozen=True)
class _Drawer:
    """Draws rotations as the set's images were drawn."""

    annotator: Annotator
    marking_trace: MarkingTrace | None
    audits: dict[Volume, VolumeAudit] = field(default_factory=dict)

    def audit_of(self, volume: Volume, size_px: int) -> VolumeAudit:
        """Return what audits a volume, which images share."""
        if volume not in self.audits:
            self.audits[volume] = VolumeAudit(volume, self.annotator.spec.tolerance_px, size_px)
        return self.audits[volume]

    def differing_px(self, R_gt: Rotations, R_m2c: Rotations) -> float | None:
        """Return by how many pixels the image at R_m2c differs from that at R_gt; None without the general rule."""
        rule = self.annotator.general_rule
        if rule is None:
            return None
        return 0.0 if rule.spec.marking is None else float(rule.between(R_gt, R_m2c[None])[0])

    def draws(self, sample: Sample, R_m2c: Rotations) -> bool:
        """Tell whether a rotation (3, 3) draws an image's pixels, but for a few at edges."""
        view = self.annotator.renderer.render(R_m2c)
        segmentation = np.count_nonzero(view.segmentation != sample.segmentation)
        rgb = np.abs(view.rgb.astype(np.int16) - sample.image.astype(np.int16)).max(axis=-1) > RGB_LEVELS
        return bool(segmentation <= EDGE_PIXELS and np.count_nonzero(rgb) <= EDGE_PIXELS)

    def draw(self, R_m2c: Rotations) -> _Drawing:
        """Return the drawing of one rotation (3, 3)."""
        view = self.annotator.renderer.render(R_m2c)
        coset_px = self.annotator.shown_px(R_m2c, view)
        return self.drawing(view.rgb, view.segmentation, view.depth, coset_px)

    def faults_of_member(self, stored: "_Drawing", drawn: "_Drawing", differing_px: float | None) -> list[str]:
        """Say in what a member draws another image, given by how much it differs from it by the general rule."""
        tolerance_px = self.annotator.spec.tolerance_px
        if differing_px is None or tolerance_px is None:
            return _faults_of_member(stored, drawn)
        within_px = min(differing_px, tolerance_px)
        faults = _faults_of_member(stored, drawn, within_px, is_round=self._has_rim_of_facets)
        if differing_px >= tolerance_px + EDGE_AREA_PX:
            faults.append(f"differs in {differing_px:g} pixels of the parts that break the symmetry")
        return faults

    @property
    def _has_rim_of_facets(self) -> bool:
        """Whether facets that stand for a round body decide what is drawn at its rim."""
        spec, ball = self.annotator.spec, self.annotator.ball_rule
        is_sphere = spec.is_ball and ball is not None and engine_named(ball.settings.engine).draws_spheres
        return spec.max_offset > 0 and not is_sphere

    def drawing(
        self,
        rgb: npt.NDArray[np.uint8],
        segmentation: npt.NDArray[np.uint8],
        depth: npt.NDArray[np.float32] | None,
        coset_px: float,
    ) -> _Drawing:
        """Return what pictures and an area say by the set's rule and colours."""
        shows = bool(self.annotator.is_shown(coset_px))
        trace = np.zeros(segmentation.shape, bool) if self.marking_trace is None else self.marking_trace.of(rgb)
        return _Drawing(rgb, segmentation, depth, trace, coset_px, shows)


def _faults_of_member(
    stored: _Drawing, drawn: _Drawing, differing_px: float | None = None, *, is_round: bool = False
) -> list[str]:
    """Say in what a member of an image's set draws another image.

    Args:
        stored: the image.
        drawn: the member's drawing.
        differing_px: by how much the general rule lets them differ, by which a part may show in one alone; None where
            another rule is the set's.
        is_round: whether facets stand for a round body: its rim, where it is lit at a grazing angle, then depends on
            where they lie, and pixels beside it are not compared.
    """
    faults = []
    if drawn.shows != stored.shows and differing_px is None:
        verbs = {True: "shows", False: "hides"}
        faults.append(
            f"{verbs[drawn.shows]} the marking ({drawn.coset_px:g} pixels), which the image {verbs[stored.shows]}"
        )
    if drawn.coset_px == 0 and drawn.trace.any():
        faults.append("hides the marking, yet its RGB carries a trace of the marking's colour")
    below_tolerance = sum(0 if drawing.shows else drawing.coset_px for drawing in (stored, drawn))
    allowed = EDGE_PIXELS + round(_POINTS_PER_PIXEL * max(below_tolerance, differing_px or 0.0))
    inside = ~(_beside_background(stored.segmentation) | _beside_background(drawn.segmentation)) | (not is_round)
    rgb = np.abs(stored.rgb.astype(np.int16) - drawn.rgb.astype(np.int16)).max(axis=-1) > RGB_LEVELS
    differing = {
        "segmentation": int(np.count_nonzero((stored.segmentation != drawn.segmentation) & inside)),
        "RGB": int(np.count_nonzero(rgb & inside)),
    }
    if stored.depth is not None and drawn.depth is not None:
        differing["depth"] = int(np.count_nonzero((np.abs(stored.depth - drawn.depth) > DEPTH_RADII) & inside))
    faults += [
        f"{count} pixels of the {name} differ, at most {allowed} may"
        for name, count in differing.items()
        if count > allowed
    ]
    return faults


def _beside_background(segmentation: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Tell which pixels (H, W) are background, or one or two pixels from it."""
    height, width = segmentation.shape
    padded, reach = np.pad(segmentation == BACKGROUND, 2), range(5)
    return np.any([padded[down : down + height, right : right + width] for down in reach for right in reach], axis=0)


def _chosen(symmetry_set: SymmetrySet, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Return candidates to draw: half at random, half where the set ends, members and rejected in equal parts."""
    mask, group = symmetry_set.is_member, symmetry_set.group  # R g is as far from R g' as g from g'
    chosen: list[npt.NDArray[np.intp]] = []
    for side in (mask, ~mask):
        indices = np.flatnonzero(side)
        if len(indices):
            quota = min(len(indices), CANDIDATES_PER_IMAGE // 2)
            order = indices[np.argsort(_angle_to_nearest_rad(group, ~side)[indices], kind="stable")]
            at_the_end = order[: quota // 2]
            rest = np.setdiff1d(indices, at_the_end)
            chosen += [at_the_end, rng.choice(rest, size=min(len(rest), quota - len(at_the_end)), replace=False)]
    return np.concatenate(chosen)


def _angle_to_nearest_rad(group: Rotations, others: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return the angle from each element of the group to the nearest of `others`; 0 where there are none."""
    if not others.any():
        return np.zeros(len(group))
    trace = np.einsum("aij,bij->ab", group, group[others])  # exact enough to order elements a degree apart
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)).min(axis=1))


def _angle_to_members_rad(symmetry_set: SymmetrySet, index: int) -> float:
    """Return the angle in rad from a candidate to the nearest member."""
    return float(angle_between(symmetry_set.turns, symmetry_set.group[index]).min())
