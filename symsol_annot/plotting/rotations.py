"""Sets of rotations, true and predicted: in the ball of rotation vectors, and on the sphere of directions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from symsol_annot.annotation.symmetry_set import SymmetrySet
from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import RotationError
from symsol_annot.plotting.canvas import (
    PREDICTED,
    TRUTH,
    label_text,
    legend_below,
    legend_mark,
    new_figure,
    write_figure,
)
from symsol_annot.rendering.frames.shading import srgb
from symsol_annot.rotations.so3 import Angles, Rotations
from symsol_annot.sets.dataset import Sample

KINDS = ("pi-ball", "mollweide")
_VIEW_DEG = {"elev": 18.0, "azim": -60.0}
_MAP_FROM_CAMERA = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # towards the camera, right, up
_SHOWN_FROM_MODEL = Rotation.from_euler("ZYX", [0.2, 0.2, 0.2]).as_matrix()  # Q
_PICTURE_INCHES = {"pi-ball": 2.4, "mollweide": 3.6}
_PLACES = {
    "pi-ball": "rotation vectors (axis times angle) in the ball of radius π",
    "mollweide": "place: where an axis of the model points, the camera in the middle; colour: the tilt about it",
}
_DOTS_OF_VOLUME = 1500  # that show a volume
_BANDS, _TILTS = 60, 48  # of latitude, on the map; tilts per direction that are asked about
_MANY = 60  # members from which on they are drawn small
_OKLAB_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
_LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def plot_sets(
    samples: Sequence[Sample],
    path: Path,
    kind: str = "pi-ball",
    predicted: Sequence[Rotations] | None = None,
    title: str = "",
) -> None:
    """Write a picture with one row per image: the image, and its symmetry set.

    Args:
        samples: annotated.
        path: a PNG, PDF or SVG.
        kind: "pi-ball" or "mollweide".
        predicted: (m, 3, 3) rotations of each sample, drawn over the truth.
        title: over the whole.

    Raises:
        OutputError: the file cannot be written.
        SettingsError: it is none of those forms.
        MissingExtraError: matplotlib is not installed.
    """
    width = _PICTURE_INCHES[kind]
    projection = "mollweide" if kind == "mollweide" else "3d"
    figure = new_figure(figsize=(2.0 + width, 2.2 * len(samples) + 0.9), layout="constrained")
    grid = figure.add_gridspec(len(samples), 2, width_ratios=(2.0, width))
    for row, sample in enumerate(samples):
        image = figure.add_subplot(grid[row, 0])
        image.imshow(sample.image, interpolation="antialiased")
        image.set(xticks=[], yticks=[])
        image.set_title(f"image {sample.index}", fontsize=8, pad=2)
        axes = figure.add_subplot(grid[row, 1], projection=projection)
        found = None if predicted is None else predicted[row]
        of_image = sample.symmetry_set
        if kind == "mollweide":
            draw_mollweide(axes, of_image.members, sample.rotation, found, of_image.volume)
        else:
            draw_pi_ball(axes, shown_of(of_image), sample.rotation, found)
        count = "" if found is None else f", {len(found)} predicted"
        axes.set_title(f"{size_text(sample.symmetry_set)}{count}", fontsize=8, pad=4)
    marks = marks_of_sets(kind, predicted=predicted is not None)
    place = _PLACES[kind]
    if kind == "mollweide" and any(sample.symmetry_set.volume is not None for sample in samples):
        place += "\ngrey: the share of the tilts there that the volume of a set has, white none, dark all"
    legend_below(figure, marks, columns=3, title=place)
    if title:
        figure.suptitle(label_text(title), fontsize=9)
    write_figure(figure, path)


def shown_of(symmetry_set: SymmetrySet) -> Rotations:
    """Return the rotations (k, 3, 3) that stand for a set in a picture: its members, and of a volume some, evenly."""
    if symmetry_set.volume is None:
        return symmetry_set.members
    drawn = symmetry_set.volume.sample(_DOTS_OF_VOLUME, np.random.default_rng(0))
    return np.concatenate([symmetry_set.members, drawn])


def size_text(symmetry_set: SymmetrySet) -> str:
    """Return how large a set is, in words."""
    if symmetry_set.volume is not None:
        return f"{symmetry_set.measure:.1%} of all rotations"
    count = len(symmetry_set.turns)
    return f"{count} rotation{'s' * (count != 1)}"


def marks_of_sets(kind: str = "pi-ball", *, predicted: bool = False) -> list[Any]:
    """Return what a legend says of the marks in the ball, or on the map, whose colours are tilts."""
    truth, guess = (TRUTH, PREDICTED) if kind == "pi-ball" else ("0.35", "0.35")
    marks = [
        legend_mark("symmetry set", truth, "o", markersize=4),
        legend_mark("drawn at this rotation", "black", "o", markersize=7, fillstyle="none"),
        legend_mark("predicted", guess, "x", markersize=5),
    ]
    return marks if predicted else marks[:2]


def draw_pi_ball(
    axes: Any, rotations: Rotations, R_gt: Rotations | None = None, predicted: Rotations | None = None
) -> None:
    """Draw rotations as rotation vectors in the ball of radius pi (section 2.1.3).

    Args:
        axes: a 3D axes of matplotlib.
        rotations: (k, 3, 3), as dots.
        R_gt: (3, 3) one rotation to point out, by a ring, or None.
        predicted: (m, 3, 3), as crosses, or None.
    """
    _draw_ball_outline(axes)
    points = Rotation.from_matrix(rotations).as_rotvec()
    axes.scatter(*points.T, s=6 if len(points) > _MANY else 18, color=TRUTH, depthshade=True, linewidths=0)
    if R_gt is not None:
        at = Rotation.from_matrix(R_gt).as_rotvec()
        axes.scatter(*at[:, None], s=42, facecolors="none", edgecolors="black", linewidths=1.2)
    if predicted is not None and len(predicted):
        crosses = Rotation.from_matrix(predicted).as_rotvec()
        axes.scatter(*crosses.T, s=22, marker="x", color=PREDICTED, depthshade=False, linewidths=1.1)
    axes.set(xlim=(-np.pi, np.pi), ylim=(-np.pi, np.pi), zlim=(-np.pi, np.pi))
    axes.set_box_aspect((1, 1, 1), zoom=1.45)
    axes.view_init(**_VIEW_DEG)
    axes.set_axis_off()


def draw_mollweide(
    axes: Any,
    rotations: Rotations,
    R_gt: Rotations | None = None,
    predicted: Rotations | None = None,
    volume: Volume | None = None,
) -> None:
    """Draw rotations on the sphere of directions, with the tilt as colour (Murphy et al., Implicit-PDF).

    A rotation's place is where an axis of the model points, in a map whose middle is towards the camera and whose right
    is the image's. Its colour is the tilt about that axis, see `directions_and_tilts`.

    Args:
        axes: of matplotlib's projection "mollweide".
        rotations: (k, 3, 3), as dots.
        R_gt: (3, 3) one rotation to point out, by a ring, or None.
        predicted: (m, 3, 3), as crosses, or None.
        volume: is shown as a density: how dark a direction is tells the share of its tilts that are inside.
    """
    if volume is not None:
        _shade(axes, volume)

    def scatter(R: Rotations, **marks: Any) -> None:
        longitude, latitude, tilt = directions_and_tilts(R)
        axes.scatter(longitude, latitude, **{"color": tilt_colours(tilt), **marks})

    scatter(rotations, s=10 if len(rotations) > _MANY else 34, linewidths=0, zorder=2)
    if R_gt is not None:
        scatter(R_gt[None], s=80, color="none", edgecolors="black", linewidths=1.2, zorder=3)
    if predicted is not None and len(predicted):
        scatter(predicted, s=40, marker="x", linewidths=1.4, zorder=4)
    axes.grid(visible=True, color="0.85", linewidth=0.5)
    axes.set(xticklabels=[], yticklabels=[])
    _draw_tilt_wheel(axes)


def directions_and_tilts(R_m2c: Rotations) -> tuple[Angles, Angles, Angles]:
    """Return where an axis of the model points, and the tilt about it, in rad.

    The axis is the first column of Q = Rz(0.2) Ry(0.2) Rx(0.2), which lies on no axis of symmetry, so that the
    rotations of a set get places of their own. In axes towards the camera, right and up,
    R Q = Rz(longitude) Ry(-latitude) Rx(tilt), as Implicit-PDF's plots have it.

    Args:
        R_m2c: (..., 3, 3).

    Returns:
        longitude in [-pi, pi], latitude in [-pi/2, pi/2], tilt in [-pi, pi]: (...) each.

    Raises:
        RotationError: a trailing shape is not (3, 3).
    """
    if R_m2c.shape[-2:] != (3, 3):
        raise RotationError(f"expected rotations (..., 3, 3), found {R_m2c.shape}")
    R = _MAP_FROM_CAMERA @ R_m2c @ _SHOWN_FROM_MODEL
    longitude = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    latitude = np.arcsin(np.clip(R[..., 2, 0], -1.0, 1.0))
    return longitude, latitude, np.arctan2(R[..., 2, 1], R[..., 2, 2])


def rotations_at(longitude: Angles, latitude: Angles, tilt: Angles) -> Rotations:
    """Return the rotations (..., 3, 3) whose `directions_and_tilts` are such, in rad, (...) each."""
    longitude, latitude, tilt = np.broadcast_arrays(longitude, latitude, tilt)
    turned = Rotation.from_euler("ZYX", np.stack([longitude, -latitude, tilt], -1).reshape(-1, 3)).as_matrix()
    R: Rotations = _MAP_FROM_CAMERA.T @ turned.reshape(*longitude.shape, 3, 3) @ _SHOWN_FROM_MODEL.T
    return R


def shares_of_tilts(volume: Volume, longitude: Angles, latitude: Angles) -> Angles:
    """Return how large a share of the tilts about each direction (...), in rad, is inside a volume, from 0 to 1."""
    tilts = (np.arange(_TILTS) + 0.5) * (2.0 * np.pi / _TILTS)
    R = rotations_at(longitude[..., None], latitude[..., None], tilts)
    return volume.contains(R.reshape(-1, 3, 3)).reshape(R.shape[:-2]).mean(-1)


def _shade(axes: Any, volume: Volume) -> None:
    edges_lon, edges_lat = np.linspace(-np.pi, np.pi, 2 * _BANDS + 1), np.linspace(-np.pi / 2, np.pi / 2, _BANDS + 1)
    middles = ((edges[:-1] + edges[1:]) / 2.0 for edges in (edges_lon, edges_lat))
    shares = shares_of_tilts(volume, *np.meshgrid(*middles))
    axes.pcolormesh(edges_lon, edges_lat, shares, cmap="Greys", vmin=0.0, vmax=1.3, rasterized=True, zorder=1)


def tilt_colours(tilt_rad: Angles) -> npt.NDArray[np.float64]:
    """Return sRGB colours (..., 3) in [0, 1] on a circle in OKLab.

    Lightness and blue to yellow alone tell them apart, so that colour-blind eyes can.
    """
    lab = np.stack([0.65 + 0.14 * np.cos(tilt_rad), -0.09 * np.cos(tilt_rad), 0.13 * np.sin(tilt_rad)], axis=-1)
    return srgb(np.clip((lab @ _OKLAB_TO_LMS.T) ** 3 @ _LMS_TO_RGB.T, 0.0, 1.0))


def _draw_tilt_wheel(axes: Any) -> None:
    wheel = axes.inset_axes((0.95, -0.1, 0.13, 0.26), projection="polar")
    turn = np.linspace(0.0, 2.0 * np.pi, 73)[:-1]
    wheel.bar(turn, 0.4, width=turn[1], bottom=0.6, color=tilt_colours(turn), linewidth=0)
    wheel.set(xticks=[], yticks=[], ylim=(0.0, 1.0))
    wheel.spines["polar"].set_visible(False)
    wheel.text(0.0, 0.0, "tilt", fontsize=5, ha="center", va="center")


def _draw_ball_outline(axes: Any) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.pi * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    for shift in range(3):
        axes.plot(*np.roll(circle, shift, axis=0), color="0.8", linewidth=0.6)
    for axis, name in enumerate("xyz"):
        ends = np.zeros((3, 2))
        ends[axis] = [-np.pi, np.pi]
        axes.plot(*ends, color="0.85", linewidth=0.5)
        axes.text(*(1.1 * ends[:, 1]), name, fontsize=6, color="0.5", ha="center", va="center")
