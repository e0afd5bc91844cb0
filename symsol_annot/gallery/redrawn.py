"""Candidates of an image, drawn again: members of its set look the same, rejected candidates do not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError, RendererMissingError
from symsol_annot.gallery.runs import Run
from symsol_annot.gallery.sources import Source
from symsol_annot.generation.origin import plan_behind
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.nearest import nearest_angles
from symsol_annot.sets.dataset import Dataset, Sample

DRAWN_A_SIDE = 4  # members, and as many rejected candidates

OpenRenderer = Callable[[ObjectSpec, Camera, RenderSettings], Renderer]
Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Drawing:
    """A candidate R_gt g, drawn.

    Attributes:
        element: the index of g in the body's group.
        is_member: whether it is in the image's symmetry set.
        angle_deg: from the image's own rotation for a member; from the nearest member for a rejected candidate.
        differing_px: in how many pixels its segmentation differs from the image's.
        image: (H, W, 3) u8 RGB.
    """

    element: int
    is_member: bool
    angle_deg: float
    differing_px: int
    image: Bytes


class Redrawer:
    """Draws candidates of one source's images; `missing` says why it cannot, or is empty.

    Args:
        source: whose images.
        runs: over them; the worst images of the first run are taken, else images evenly over the split.
        count: of how many images.
        given: the object, where it is not built in.
        open_renderer: opens what draws.

    Attributes:
        images: which images are drawn again, ascending.
        missing: why none are.
    """

    def __init__(
        self,
        source: Source,
        runs: Sequence[Run],
        count: int,
        given: ObjectSpec | None = None,
        open_renderer: OpenRenderer = RenderProcess,
    ) -> None:
        self._renderer: Renderer | None = None
        self.missing = "none were asked for"
        if count:
            self._renderer, self.missing = _opened(source.dataset, given, open_renderer)
        self.images = _chosen_images(len(source.dataset), count, runs) if self._renderer else ()

    def draw(self, sample: Sample) -> list[Drawing]:
        """Return the drawings of an image, members first, each side from near to far.

        Raises:
            RenderError: Blender stopped.
        """
        renderer = self._renderer
        if renderer is None or sample.index not in self.images:
            return []
        return [_drawn(renderer, sample, element, angle) for element, angle in _chosen_candidates(sample)]

    def close(self) -> None:
        """End the renderer."""
        if self._renderer:
            self._renderer.close()


def _opened(dataset: Dataset, given: ObjectSpec | None, open_renderer: OpenRenderer) -> tuple[Renderer | None, str]:
    """Return what draws a set's object as its images were drawn, or None and why there is no such thing."""
    try:
        plan = plan_behind(dataset.folder, dataset.manifest, given)
        renderer = open_renderer(plan.spec, plan.camera, plan.settings)
        _ = renderer.versions  # starts it
    except (DataError, RendererMissingError) as error:
        return None, str(error)
    return renderer, ""


def _drawn(renderer: Renderer, sample: Sample, element: int, angle_rad: float) -> Drawing:
    symmetry_set = sample.symmetry_set
    view = renderer.render(symmetry_set.R_gt @ symmetry_set.group[element])
    differing = int(np.count_nonzero(view.segmentation != sample.segmentation))
    return Drawing(element, bool(_are_in_set(sample)[element]), float(np.degrees(angle_rad)), differing, view.rgb)


def _are_in_set(sample: Sample) -> npt.NDArray[np.bool_]:
    """Tell which candidates (G,) are in an image's set, as members or inside of its volume."""
    found = sample.symmetry_set
    is_inside = False if found.volume is None else found.volume.contains(found.candidates)
    return np.asarray(found.is_member | is_inside)


def _chosen_images(images: int, count: int, runs: Sequence[Run]) -> tuple[int, ...]:
    if runs:
        worst = runs[0].worst_first()
        return tuple(sorted(int(i) for i in worst[worst < images][:count]))
    return tuple(int(i) for i in _spread(np.arange(images), count))


def _chosen_candidates(sample: Sample) -> list[tuple[int, float]]:
    """Return members but the image itself, and rejected candidates, each with its angle in rad, from near to far.

    The angle between R g and R g' is that between g and g'.
    """
    is_member, group = _are_in_set(sample), sample.symmetry_set.group
    members, rejected = np.flatnonzero(is_member), np.flatnonzero(~is_member)
    sides = ((members[members != 0], group[:1]), (rejected, group[members]))  # the identity is the image itself
    return [
        candidate
        for elements, origin in sides
        if len(elements)
        for candidate in _near_to_far(elements, nearest_angles(group[elements], origin))
    ]


def _near_to_far(elements: npt.NDArray[np.intp], angles: npt.NDArray[np.float64]) -> list[tuple[int, float]]:
    order = _spread(np.argsort(angles, kind="stable"), DRAWN_A_SIDE)
    return [(int(elements[i]), float(angles[i])) for i in order]


def _spread(values: npt.NDArray[np.intp], count: int) -> npt.NDArray[np.intp]:
    """Return `count` of the values (or all), the first and the last among them, evenly spaced."""
    if len(values) <= count:
        return values
    return values[np.linspace(0, len(values) - 1, count).round().astype(int)]
