"""A classifier along a line of rotations: what it says of those that turn R_gt about one axis (figure 7.5)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from symsol_annot.bench.models.kinds import kind_of
from symsol_annot.bench.models.networks.answers import embeddings_of, probabilities
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.training.checkpoints import Checkpoint
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.errors import ModelError, RotationError
from symsol_annot.plotting.canvas import SERIES, label_text, legend_below, legend_mark, new_figure, write_figure
from symsol_annot.rotations.so3 import Angles, Rotations, rotations_about
from symsol_annot.sets.dataset import Dataset, Sample

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


def classifiers_for(dataset: Dataset, checkpoints: Sequence[Checkpoint]) -> list[tuple[str, RotationClassifier]]:
    """Return the classifiers in checkpoints, each with the name of its folder.

    Raises:
        ModelError: one is no classifier, or was trained on other images.
    """
    found = []
    for checkpoint in checkpoints:
        checkpoint.refuse_other_images(dataset)
        if not isinstance(checkpoint.model, RotationClassifier):
            title = kind_of(checkpoint.record.recipe).title
            raise ModelError(f"{checkpoint.path}: is a {title}; a slice is of a classifier")
        found.append((checkpoint.path.parent.name, checkpoint.model))
    return found


def slice_through(R_gt: Rotations, axis: str, angles_rad: Angles) -> Rotations:
    """Return the rotations (n, 3, 3) that turn R_gt about one of the model's axes, R_gt R_axis(angle).

    Raises:
        RotationError: there is no such axis.
    """
    if axis not in AXES:
        raise RotationError(f"expected the axis x, y or z, found {axis!r}")
    return R_gt @ rotations_about(AXES[axis], angles_rad)


def probability_along(
    classifier: RotationClassifier, sample: Sample, axis: str, angles_rad: Angles
) -> npt.NDArray[np.float64]:
    """Return what a classifier says along a slice through an image's R_gt: (n,) probabilities."""
    R = torch.from_numpy(slice_through(sample.rotation, axis, angles_rad)).float()
    embedding = embeddings_of(classifier, torch.from_numpy(sample.image)[None], 1)[0]
    said: npt.NDArray[np.float64] = probabilities(classifier, embedding, R.to(embedding)).double().cpu().numpy()
    return said


def plot_slice(
    classifiers: Sequence[tuple[str, RotationClassifier]],
    sample: Sample,
    path: Path,
    axis: str = "x",
    reach_deg: float = 180.0,
) -> None:
    """Write the probabilities of classifiers along a slice through an image's R_gt; dotted are the set's own rotations.

    Args:
        classifiers: names and models, a curve each.
        sample: the image; annotated, or its set is not shown.
        path: a PNG, PDF or SVG.
        axis: the model's axis to turn about: "x", "y" or "z".
        reach_deg: how far to both sides.

    Raises:
        RotationError: another axis.
        OutputError: the picture cannot be written.
        SettingsError: it is none of those forms.
        MissingExtraError: matplotlib is not installed.
    """
    angles_deg = np.linspace(-reach_deg, reach_deg, 1441)
    figure = new_figure(figsize=(5.4, 3.0), layout="constrained")
    axes = figure.add_subplot()
    for number, (name, classifier) in enumerate(classifiers):
        said = probability_along(classifier, sample, axis, np.radians(angles_deg))
        axes.plot(angles_deg, said, color=SERIES[number % len(SERIES)], linewidth=1.2, label=label_text(name))
    for angle_deg in members_on(sample, axis):
        axes.axvline(angle_deg, color="0.6", linewidth=0.6, linestyle=":")
    axes.axhline(STANDARD_THRESHOLD, color="0.8", linewidth=0.6)
    handles, _ = axes.get_legend_handles_labels()
    lines = (legend_mark("symmetry set", line=":"), legend_mark(f"threshold {STANDARD_THRESHOLD:g}", "0.8", line="-"))
    axes.set(xlim=(-reach_deg, reach_deg), ylim=(-0.02, 1.02), ylabel="probability")
    axes.set_xlabel(f"turn about the model's {axis} axis, degrees")
    axes.set_title(f"image {sample.index}", fontsize=8)
    legend_below(figure, [*handles, *lines])
    write_figure(figure, path)


def members_on(sample: Sample, axis: str) -> Angles:
    """Return at which angles in degrees, in (-180, 180], a slice through R_gt meets members of the image's set."""
    if not sample.is_annotated:
        return np.zeros(0)
    turns = sample.symmetry_set.turns
    along = np.array(AXES[axis], dtype=np.float64)
    (about,) = np.nonzero(np.linalg.norm(turns @ along - along, axis=-1) < 1e-6)
    u, v = np.roll(along, 1), np.roll(along, 2)
    angles: Angles = np.degrees(np.arctan2(turns[about] @ u @ v, turns[about] @ u @ u))
    return np.sort(angles)
