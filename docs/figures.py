"""Draws docs/images/annotation.png, with real counts from Blender: .venv/bin/python docs/figures.py."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.path import Path as Polygon

from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.objects.spec import load_object
from symsol_annot.plotting.canvas import legend_below
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import label_rotation

INDEX = 3  # of the test split of seed 0: a view that hides the disc
HIDDEN, SHOWN, OPEN = "#4477aa", "#ee6677", "#222222"
CLOSE = 10**9  # asks for close bounds everywhere


def main():
    """Draw what decides a hidden view's candidates, and the samples of one that barely shows the disc."""
    spec, camera, settings = load_object("cylO"), Camera.filling(224), RenderSettings()
    candidates = label_rotation(0, "cylO", "test", INDEX) @ spec.symmetry_group
    with RenderProcess(spec, camera, settings) as renderer:
        counts = (renderer.marking_pixels(candidates) * settings.points_per_pixel).round().astype(int)
    if counts[0]:
        raise SystemExit(f"image {INDEX} shows the disc: choose another")
    visibility = MarkingVisibility(spec.mesh, camera, settings)
    lower, upper = visibility.bounds(candidates, CLOSE)
    if not ((lower <= counts) & (counts <= upper)).all():
        raise SystemExit("a count lies outside its bounds")
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, (whole, end, samples) = plt.subplots(
        1, 3, figsize=(12, 3.9), width_ratios=(1.3, 1, 1), layout="constrained"
    )
    _draw_decisions(whole, counts, lower, upper, range(360))
    whole.set(
        yscale="symlog", title="one circle of candidates of a hidden view", ylabel="samples of the disc that show"
    )
    first = _end_of_arc(counts)
    _draw_decisions(end, counts, lower, upper, range(first - 3, first + 4))
    end.set(yscale="symlog", title="where the arc ends", ylabel="samples of the disc that show")
    marks, _ = whole.get_legend_handles_labels()
    barely = next(k for k in range(first, first + 6) if counts[k] >= 6)
    _draw_samples(samples, spec.mesh, camera.lattice(settings.samples_per_axis), candidates[barely], counts[barely])
    legend_below(figure, [*marks, *samples.get_legend_handles_labels()[0]], columns=6)
    path = Path(__file__).parent / "images" / "annotation.png"
    figure.savefig(path, dpi=130)
    print(path)


def _end_of_arc(counts):
    """Return the first candidate after the arc of members: it shows the disc, and the one before does not."""
    circle = counts[:360] > 0
    return next(k for k in range(4, 350) if circle[k] and not circle[k - 1])


def _draw_decisions(axes, counts, lower, upper, shown):
    shown = np.array(shown)
    is_open = (lower == 0) & (upper > 0)
    axes.fill_between(shown, lower[shown], upper[shown], color="#bbbbbb", step="mid", label="between the bounds")
    groups = {
        "surely hidden": (upper == 0, HIDDEN, "o"),
        "surely shown": (lower > 0, SHOWN, "o"),
        "left to draw": (is_open, OPEN, "D"),
    }
    for label, (is_in, colour, marker) in groups.items():
        x = shown[is_in[shown]]
        if len(x):
            axes.plot(
                x, counts[x], marker, color=colour, ms=3, label=f"{label}: {is_in[:360].sum()} of the circle's 360"
            )
    axes.set(xlabel="turn about the cylinder's axis, degrees", ylim=(-0.5, None))


def _draw_samples(axes, mesh, lattice, R, count):
    """Draw the disc's front, the body beside it and the lattice of samples around them."""
    points = mesh.vertices @ R.T
    pixels = lattice.project(points)
    a, b, c = np.moveaxis(points[mesh.triangles] + [0, 0, lattice.distance], 1, 0)
    in_front = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    for is_marking, colour in ((False, "#dde6f2"), (True, "#f3a58c")):
        for triangle in mesh.triangles[in_front & (mesh.is_marking == is_marking)]:
            axes.fill(*pixels[triangle].T, color=colour, lw=0.3)
    disc = pixels[mesh.triangles[in_front & mesh.is_marking]]
    low, high = np.floor(disc.min(axis=(0, 1))) - 1, np.ceil(disc.max(axis=(0, 1))) + 1
    u, v = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    centres = np.stack([u.ravel(), v.ravel()], axis=1)
    is_inside = np.any([Polygon(corners).contains_points(centres) for corners in disc], axis=0)
    axes.plot(*centres[~is_inside].T, ".", color="#999999", ms=3, label="sample beside the disc")
    axes.plot(*centres[is_inside].T, "o", color=OPEN, ms=4, label="sample on the disc")
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), xticks=[], yticks=[])
    axes.set(
        title=f"a sliver of the disc at the rim: {count} samples",
        xlabel="along the rows of pixels (stretched)",
        ylabel="down the image",
    )


if __name__ == "__main__":
    main()
