"""The time of a hidden view's symmetry set, by geometry and by drawing every candidate, view by view in one process."""

import statistics
import time

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import label_rotation


def measure(name, views):
    """Return the medians over hidden views of both ways in ms, and of their ratio within a view."""
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    visibility = MarkingVisibility(spec.mesh, camera, settings)
    times = {"exhaustive_ms": [], "geometry_ms": []}
    with RenderProcess(spec, camera, settings) as renderer:
        for R, pixels in _hidden(spec, renderer, views):
            for way, decides in (("exhaustive_ms", None), ("geometry_ms", visibility)):
                start = time.perf_counter()
                Annotator(spec, renderer, decides).annotate(R, pixels)
                times[way].append(1e3 * (time.perf_counter() - start))
    ratio = statistics.median(slow / fast for slow, fast in zip(*times.values(), strict=True))
    return {"views": views, **{way: statistics.median(ms) for way, ms in times.items()}, "times_faster": ratio}


def _hidden(spec, renderer, views):
    index = found = 0
    while found < views:
        R = label_rotation(0, spec.name, "test", index)
        pixels = Annotator(spec, renderer).coset_px(R, float(renderer.marking_pixels(R[None])[0]))
        if pixels < spec.marking.tolerance_px:
            found += 1
            yield R, pixels
        index += 1
