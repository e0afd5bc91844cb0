"""Draws the figures of docs/conventions.md, with pictures from Blender: python docs/figures_conventions.py."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Rectangle
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about
from symsol_annot.sets.plan import label_rotation

IMAGES = Path(__file__).parent / "images"
LENGTH = 0.75  # of the model's axes in an image, in bounding-sphere radii
AXES = {"x": "#ee6677", "y": "#228833", "z": "#4477aa"}
MEMBER, REJECTED, QUIET = "#4477aa", "#bbbbbb", "#888888"
SHOWN, HIDDEN = 5, 7  # images of cylO's test split of seed 0
CAMERA, SETTINGS = Camera.filling(224), RenderSettings()


def main():
    """Draw all figures."""
    mpl.rcParams.update({"font.size": 9, "savefig.dpi": 130, "axes.titlesize": 10})
    cylinder = load_object("cylO")
    with RenderProcess(cylinder, CAMERA, SETTINGS) as renderer:
        draw_frame(cylinder, renderer)
        draw_rule(cylinder, renderer)
    draw_pixels()
    cube = load_object("cube")
    with RenderProcess(cube, CAMERA, SETTINGS) as renderer:
        draw_action(renderer)


def draw_frame(spec, renderer):
    """Camera, light and object in space; beside it the image, with the model's axes projected into it."""
    R_m2c = label_rotation(0, "cylO", "test", SHOWN)
    figure = plt.figure(figsize=(9.5, 4.2), layout="constrained")
    space = figure.add_subplot(1, 2, 1, projection="3d")
    space.view_init(elev=18, azim=-50)
    _draw_mesh(space, spec.mesh, R_m2c)
    camera = np.array([0.0, 0.0, -CAMERA.distance])
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        _arrow(space, camera, 1.2 * direction, AXES[axis], f"${axis}_c$")
    for x, y in ((-0.6, -0.6), (0.6, -0.6), (-0.6, 0.6), (0.6, 0.6)):
        _arrow(space, np.array([x, y, -2.6]), np.array([0.0, 0.0, 0.9]), "#ccaa22")
    space.text(*_plotted(np.array([0.6, -1.0, -2.6])), "light", color="#aa8800")
    space.text(*_plotted(camera + np.array([0.0, -0.5, -0.3])), "camera at (0, 0, -4)", ha="center")
    space.set(xlim=(-1.2, 1.2), ylim=(-4.2, 1.2), zlim=(-1.2, 1.2), title="the world's axes are the camera's")
    space.set_box_aspect((2.4, 5.4, 2.4), zoom=1.55)
    space.set_axis_off()
    image = figure.add_subplot(1, 2, 2)
    image.imshow(renderer.render(R_m2c).rgb, extent=(0, CAMERA.width, CAMERA.height, 0))
    _draw_model_axes(image, R_m2c)
    image.set(xlabel="u, to the right", ylabel="v, downwards", title="the image, with the columns of R_m2c")
    _save(figure, "frame")


def draw_pixels():
    """Pixels, their centres, the samples of the lattice, and their weights in one pixel."""
    figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    rows, columns = 3, 5
    for row in range(rows):
        for column in range(columns):
            axes.add_patch(Rectangle((column, row), 1, 1, fill=False, ec="#999999"))
            axes.plot(column + 0.5, row + 0.5, "o", color=MEMBER, ms=6)
            if (row, column) != (1, 2):
                axes.text(column + 0.5, row + 0.36, f"({row}, {column})", ha="center", color=QUIET, fontsize=7)
    u, v = np.meshgrid(np.arange(0, columns + 0.1, 0.5), np.arange(0, rows + 0.1, 0.5))
    axes.plot(u.ravel(), v.ravel(), ".", color="#222222", ms=3)
    axes.add_patch(Rectangle((2, 1), 1, 1, color="#ddaa33", alpha=0.25))
    for dv, weights in zip((0, 0.5, 1), ((1, 2, 1), (2, 4, 2), (1, 2, 1)), strict=True):
        for du, weight in zip((0, 0.5, 1), weights, strict=True):
            axes.text(2 + du + 0.06, 1 + dv - 0.06, weight, fontsize=8, color="#aa3377", weight="bold")
    arrow = {"arrowstyle": "->"}
    centre = "centre of the pixel in row 0, column 0:\n(u, v) = (0.5, 0.5)"
    weights = "weights, over 16, of the samples\nof the pixel in row 1, column 2"
    axes.annotate(centre, (0.58, 0.45), (0.1, -0.7), arrowprops=arrow | {"relpos": (0.6, 0.0)})
    axes.annotate(weights, (2.75, 1.02), (2.9, -0.7), arrowprops=arrow | {"relpos": (0.05, 0.0)})
    axes.set(
        xlim=(-0.15, columns + 0.15),
        ylim=(rows + 0.15, -0.9),
        aspect="equal",
        xlabel="u, to the right, in pixels",
        ylabel="v, downwards, in pixels",
    )
    axes.set(xticks=range(columns + 1), yticks=range(rows + 1))
    axes.spines[:].set_visible(False)
    _save(figure, "pixels")


def draw_action(renderer):
    """An image of a cube, that of R g, which is the same, and that of g R, which is not."""
    R_gt = label_rotation(0, "cube", "test", 0)
    g = rotations_about((0, 0, 1), np.pi / 2)
    figure, panels = plt.subplots(1, 3, figsize=(9.5, 3.7), layout="constrained")
    titles = ("R: the image", "R @ g: the same image", "g @ R: another one")
    pictures = []
    for axes, title, R in zip(panels, titles, (R_gt, R_gt @ g, g @ R_gt), strict=True):
        pictures.append(renderer.render(R).rgb)
        axes.imshow(pictures[-1], extent=(0, CAMERA.width, CAMERA.height, 0))
        _draw_model_axes(axes, R)
        axes.set(title=title, xticks=[], yticks=[])
    if np.abs(pictures[0].astype(int) - pictures[1]).max() > 2 or np.array_equal(pictures[0], pictures[2]):
        raise SystemExit("the pictures do not show what their titles say")
    _save(figure, "action")


def draw_rule(spec, renderer):
    """Six candidates of an image that shows the disc and of one that hides it, and all 360 of a circle."""
    turns = range(0, 360, 60)
    figure, panels = plt.subplots(2, 7, figsize=(12, 4.4), layout="constrained")
    for row, (name, index) in enumerate({"shows": SHOWN, "hides": HIDDEN}.items()):
        R_gt = label_rotation(0, "cylO", "test", index)
        annotator = Annotator(spec, renderer)
        mask = annotator.annotate(R_gt, annotator.coset_px(R_gt, renderer.render(R_gt).marking_pixels)).mask
        for axes, turn in zip(panels[row], turns, strict=False):
            axes.imshow(renderer.render(R_gt @ spec.symmetry_group[turn]).rgb)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(color=MEMBER if mask[turn] else REJECTED, linewidth=4 if mask[turn] else 1)
            axes.set_xlabel("in S" if mask[turn] else "not in S", color=MEMBER if mask[turn] else QUIET)
            axes.set_title(f"turned by {turn}°" if turn else f"the image {name} the disc", fontsize=8)
        panels[row, -1].remove()
        circle = figure.add_subplot(2, 7, 7 * row + 7, projection="polar")
        angles = np.radians(np.arange(360))
        circle.plot(angles[~mask[:360]], np.ones((~mask[:360]).sum()), ".", color=REJECTED, ms=2)
        circle.plot(angles[mask[:360]], np.ones(mask[:360].sum()), "o", color=MEMBER, ms=3)
        circle.set(rticks=[], ylim=(0, 1.15), xticks=np.radians(list(turns)))
        circle.tick_params(labelsize=6, pad=-2)
        circle.spines[:].set_visible(False)
        circle.set_title(f"{mask[:360].sum()} of 360", fontsize=8)
    _save(figure, "rule")


def _plotted(points):
    """Return points in matplotlib's axes, whose third points up: x, z, -y."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]])


def _arrow(space, start, step, colour, label=""):
    space.quiver(*_plotted(start), *_plotted(step), color=colour, lw=2, arrow_length_ratio=0.15)
    space.text(*_plotted(start + 1.15 * step), label, color=colour, fontsize=11)


def _draw_mesh(space, mesh, R_m2c):
    """Draw the triangles that this plot's viewer sees, in the marking's and the body's colour."""
    points = mesh.vertices @ R_m2c.T
    a, b, c = (points[mesh.triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    light = np.clip(-normals[:, 2] / np.linalg.norm(normals, axis=1), 0, 1)[:, None]
    colours = np.where(mesh.is_marking[:, None], [0.93, 0.4, 0.2], [0.78, 0.85, 0.95]) * (0.45 + 0.55 * light)
    triangles = np.moveaxis(_plotted(points[mesh.triangles]), 0, -1)
    space.add_collection3d(Poly3DCollection(triangles, facecolors=colours, edgecolors=colours, linewidths=0.4))


def _draw_model_axes(axes, R_m2c):
    origin, *tips = CAMERA.project(np.vstack([np.zeros(3), LENGTH * R_m2c.T]))
    for name, tip in zip("xyz", tips, strict=True):
        axes.annotate("", tip, origin, arrowprops={"arrowstyle": "->", "color": AXES[name], "lw": 2})
        axes.text(*(origin + 1.12 * (tip - origin)), f"${name}_m$", color=AXES[name], ha="center", va="center")
    axes.set(xlim=(0, CAMERA.width), ylim=(CAMERA.height, 0))


def _save(figure, name):
    path = IMAGES / f"conventions-{name}.png"
    figure.savefig(path)
    plt.close(figure)
    print(path)


if __name__ == "__main__":
    main()
