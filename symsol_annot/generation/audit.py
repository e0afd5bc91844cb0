"""Drawing images of a set again, to see that its symmetry sets are what the pictures say.

Of each audited image a sample of its candidates R_gt g is drawn, half of them where the set ends: members
next to candidates that were rejected, and the other way round.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.annotate import coset_marking_px, is_shown
from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.scene import MARKING, Renderer, View
from symsol_annot.rotations.so3 import Rotations, angle_between
from symsol_annot.sets.dataset import Dataset, Sample

EDGE_PIXELS = 8  # how many pixels two drawings of one view may differ in: vertices round to other sub-pixels
RGB_LEVELS = 12  # how far a pixel must be off to count; a sample is worth a sixteenth to a quarter of the contrast
CANDIDATES_PER_IMAGE = 24
NEAR_RAD = np.radians(15.0)  # so far a candidate may be that draws a marking of a pixel or two the same
_SAMPLES_PER_PIXEL = 4  # each sample of a marking below the tolerance can colour a pixel


@dataclass
class AuditReport:
    """What an audit saw.

    Attributes:
        images: how many images were drawn again.
        members: how many members of their sets were drawn.
        rejected: how many rejected candidates were drawn.
        near_neighbours: of images that show the marking: rejected candidates that draw the same pixels. The set
            is the answer of the continuous limit; these show how far a pixel grid falls short of it.
        within_tolerance: candidates whose marking shows, but by less than the tolerance.
        faults: what contradicts the set, one line each.
    """

    images: int = 0
    members: int = 0
    rejected: int = 0
    near_neighbours: int = 0
    within_tolerance: int = 0
    faults: list[str] = field(default_factory=list)


def audit(
    dataset: Dataset,
    spec: ObjectSpec,
    renderer: Renderer,
    count: int,
    rng: np.random.Generator,
    on_image: Callable[[], object] = lambda: None,
) -> AuditReport:
    """Draw `count` random images of a split again, each with a sample of its candidates.

    Raises:
        NotAnnotatedError: the split has no symmetry sets.
        DataError: the set was imported.
    """
    if not dataset.is_annotated:
        raise NotAnnotatedError(f"{dataset.folder}: the split {dataset.split!r} has no symmetry sets to audit")
    report = AuditReport()
    for row in np.sort(rng.choice(len(dataset), size=min(count, len(dataset)), replace=False)):
        _audit_image(dataset[int(row)], spec, renderer, rng, report)
        report.images += 1
        on_image()
    return report


def _audit_image(
    sample: Sample, spec: ObjectSpec, renderer: Renderer, rng: np.random.Generator, report: AuditReport
) -> None:
    if sample.segmentation is None or sample.marking_visible is None:
        raise DataError("an imported set cannot be audited: how its images were drawn is not known")
    view = View(sample.image, sample.segmentation, sample.marking_pixels)
    stored = _Drawing(view, sample.marking_pixels, sample.marking_visible)
    found = _faults_of_member(stored, _draw(sample.rotation, spec, renderer))
    report.faults += [f"image {sample.index}, drawn again at its own rotation: {what}" for what in found]
    for index in _chosen(sample, rng):
        drawn = _draw(sample.rotation @ spec.symmetry_group[index], spec, renderer)
        report.within_tolerance += int(drawn.coset_px > 0 and not drawn.shows)
        if np.asarray(sample.symmetry_mask)[index]:
            report.members += 1
            found = [f"member {index} of its set: {what}" for what in _faults_of_member(stored, drawn)]
        else:
            report.rejected += 1
            is_same = stored.draws_the_marking_of(drawn)
            is_near = is_same and stored.shows and _angle_to_members_rad(sample, index) <= NEAR_RAD
            report.near_neighbours += int(is_near)
            found = [f"candidate {index} was rejected, but draws the same marking"] if is_same and not is_near else []
        report.faults += [f"image {sample.index}, {what}" for what in found]


@dataclass(frozen=True)
class _Drawing:
    """A view, by how much its coset shows the marking, and whether that counts as shown."""

    view: View
    coset_px: float
    shows: bool

    @property
    def trace(self) -> npt.NDArray[np.bool_]:
        """Where the RGB is more red than blue, as body and background never are: a sixth of a pixel or more marked."""
        return np.asarray(self.view.rgb[..., 0] > self.view.rgb[..., 2])

    def draws_the_marking_of(self, other: "_Drawing") -> bool:
        """Tell whether both hide the marking, or both show it in the very same pixels."""
        if not self.shows or not other.shows:
            return self.shows == other.shows
        same_ids = np.array_equal(self.view.segmentation == MARKING, other.view.segmentation == MARKING)
        return same_ids and np.array_equal(self.trace, other.trace)


def _draw(R_m2c: Rotations, spec: ObjectSpec, renderer: Renderer) -> _Drawing:
    view = renderer.render(R_m2c)
    coset_px = coset_marking_px(spec, R_m2c, view.marking_pixels, renderer)
    return _Drawing(view, coset_px, bool(is_shown(spec, coset_px)))


def _faults_of_member(stored: _Drawing, drawn: _Drawing) -> list[str]:
    """Say in what a member of an image's set draws another image."""
    faults = []
    if drawn.shows != stored.shows:
        verbs = {True: "shows", False: "hides"}
        faults.append(
            f"{verbs[drawn.shows]} the marking ({drawn.coset_px:g} pixels), which the image {verbs[stored.shows]}"
        )
    if drawn.coset_px == 0 and drawn.trace.any():
        faults.append("hides the marking, yet its RGB carries a trace of the marking's colour")
    below_tolerance = sum(0 if drawing.shows else drawing.coset_px for drawing in (stored, drawn))
    allowed = EDGE_PIXELS + round(_SAMPLES_PER_PIXEL * below_tolerance)
    rgb = np.abs(stored.view.rgb.astype(np.int16) - drawn.view.rgb.astype(np.int16)).max(axis=-1) > RGB_LEVELS
    differing = {
        "segmentation": int(np.count_nonzero(stored.view.segmentation != drawn.view.segmentation)),
        "RGB": int(np.count_nonzero(rgb)),
    }
    faults += [
        f"{count} pixels of the {name} differ, at most {allowed} may"
        for name, count in differing.items()
        if count > allowed
    ]
    return faults


def _chosen(sample: Sample, rng: np.random.Generator) -> npt.NDArray[np.intp]:
    """Return candidates to draw: half at random, half where the set ends, members and rejected in equal parts."""
    mask = np.asarray(sample.symmetry_mask)
    group = sample.symmetry_group
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


def _angle_to_members_rad(sample: Sample, index: int) -> float:
    members = sample.symmetry_group[np.asarray(sample.symmetry_mask)]
    return float(angle_between(members, sample.symmetry_group[index]).min())
