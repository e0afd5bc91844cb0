"""A slice of a classifier is what it says of the rotations on a line, and the set's own members lie on it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from scipy.spatial.transform import Rotation
from symsol_annot_cli.plot import plot

from symsol_annot import load
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.plots import slices as slice_plots
from symsol_annot.bench.models.plots.slices import (
    classifiers_for,
    members_on,
    plot_slice,
    probability_along,
    slice_through,
)
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.training import checkpoints
from symsol_annot.bench.models.training.checkpoints import Checkpoint, new_model
from symsol_annot.errors import ModelError, RotationError

torch.set_num_threads(1)


def checkpoint_of(name, tmp_path):
    """A checkpoint with first weights, and what a slice asks of its record."""
    recipe = load_recipe(name).for_object("tetX", has_marking=True)
    record = SimpleNamespace(recipe=recipe, object="tetX", image_size=(32, 32))
    return Checkpoint(tmp_path / name / "weights.safetensors", record, new_model(recipe, None, 0).eval())


@pytest.fixture(scope="module")
def classifier():
    return RotationClassifier(pretrained=None, rng=torch.Generator().manual_seed(0)).eval()


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_slice_turns_the_object_about_its_own_axis(axis, tetX_set):
    R_gt = load(tetX_set)[2].rotation
    R = slice_through(R_gt, axis, np.radians([0.0, 30.0, -90.0]))
    assert np.allclose(R[0], R_gt)
    turns = Rotation.from_euler(axis, [[30.0], [-90.0]], degrees=True).as_matrix()
    assert np.allclose(R[1:], R_gt @ turns)
    with pytest.raises(RotationError, match="expected the axis x, y or z"):
        slice_through(R_gt, "w", np.zeros(1))


def test_probabilities_are_the_models_at_those_rotations(classifier, tetX_set):
    sample = load(tetX_set)[2]
    angles_rad = np.linspace(-1.0, 1.0, 7)
    said = probability_along(classifier, sample, "y", angles_rad)
    R = sample.rotation @ Rotation.from_euler("y", angles_rad[:, None]).as_matrix()
    with torch.no_grad():
        logits = classifier(torch.from_numpy(sample.image)[None], torch.from_numpy(R).float())[0]
    assert np.allclose(said, logits.sigmoid().numpy(), atol=1e-5)
    assert said.std() > 0


def test_members_on_a_slice_are_members_of_the_set(tetX_set):
    """Of any group: here the turns by 120 degrees about z and half a turn about x, all of them members."""
    group = np.concatenate(
        [Rotation.from_euler("z", [[0], [120], [240]], degrees=True).as_matrix(), np.diag([1.0, -1.0, -1.0])[None]]
    )
    sample = replace(load(tetX_set)[2], symmetry_group=group, symmetry_mask=np.array([True, True, True, True]))
    assert np.allclose(members_on(sample, "z"), [-120, 0, 120])
    assert np.allclose(np.abs(members_on(sample, "x")), [0, 180])
    assert np.allclose(members_on(sample, "y"), [0])
    assert len(members_on(replace(sample, symmetry_mask=None), "z")) == 0


def drawn_slice(monkeypatch, classifiers, sample, axis, reach_deg):
    """The axes of a picture, what its curves are and where its vertical lines stand."""
    figures = []
    monkeypatch.setattr(slice_plots, "write_figure", lambda figure, _: figures.append(figure))
    plot_slice(classifiers, sample, Path("slice.png"), axis, reach_deg)
    (axes,) = figures[0].axes
    curves = {line.get_label(): line.get_xydata() for line in axes.lines if len(line.get_xdata()) > 2}
    upright = [line.get_xdata() for line in axes.lines if list(line.get_ydata()) == [0, 1]]
    return axes, curves, [low for low, high in upright if low == high]


@pytest.mark.parametrize("axis", ["x", "z"])
def test_a_picture_shows_the_probabilities_and_the_members(classifier, tetX_set, monkeypatch, axis):
    group = Rotation.from_euler(axis, [[0], [120], [240]], degrees=True).as_matrix()
    sample = replace(load(tetX_set)[2], symmetry_group=group, symmetry_mask=np.array([True, True, False]))
    other = RotationClassifier(pretrained=None, rng=torch.Generator().manual_seed(1)).eval()
    axes, curves, members = drawn_slice(monkeypatch, [("one", classifier), ("$b_{$", other)], sample, axis, 150.0)
    assert list(curves) == ["one", r"\$b_{\$"]
    for curve, model in zip(curves.values(), (classifier, other), strict=True):
        angles_deg, said = curve.T
        assert np.allclose(angles_deg, np.linspace(-150, 150, len(angles_deg)))
        some = slice(None, None, 144)
        R = sample.rotation @ Rotation.from_euler(axis, angles_deg[some, None], degrees=True).as_matrix()
        with torch.no_grad():
            logits = model(torch.from_numpy(sample.image)[None], torch.from_numpy(R).float())[0]
        assert np.allclose(said[some], logits.sigmoid().numpy(), atol=1e-5)
    assert np.allclose(members, [0, 120])
    assert np.allclose(members, members_on(sample, axis))
    assert axes.get_xlim() == (-150, 150)
    assert axes.get_xlabel() == f"turn about the model's {axis} axis, degrees"
    assert axes.get_title() == "image 2"
    assert axes.get_legend() is None  # it is off the curves
    (legend,) = axes.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*curves, "symmetry set", "threshold 0.8"]


def test_the_command_draws_the_checkpoints_that_it_is_given(tetX_set, tmp_path, monkeypatch):
    opened, calls = [], []

    def open_checkpoint(path):
        opened.append(path)
        return checkpoint_of("small-classifier", path)

    monkeypatch.setattr(checkpoints, "open_checkpoint", open_checkpoint)
    draw = slice_plots.plot_slice
    monkeypatch.setattr(slice_plots, "plot_slice", lambda *given: (calls.append(given), draw(*given)))
    out = tmp_path / "slice.svg"
    words = ["slice", "runs/a", "runs/b", "--data", str(tmp_path), "--image", "3", "--axis", "z", "--reach", "20"]
    done = CliRunner().invoke(plot, [*words, "--out", str(out)])
    assert done.exit_code == 0, done.exception
    assert done.output == f"{out}\n"
    assert opened == [Path("runs/a"), Path("runs/b")]
    ((classifiers, sample, *rest),) = calls
    assert ([name for name, _ in classifiers], sample.index, rest) == (2 * ["small-classifier"], 3, [out, "z", 20.0])
    assert out.read_bytes().startswith(b"<?xml")
    done = CliRunner().invoke(plot, [*words, "--image", "40", "--out", str(tmp_path / "none.svg")])
    assert done.exit_code == 2
    assert "--image 40: the split has 40 images, from 0" in done.output


def test_a_picture_is_of_classifiers_of_the_same_images_alone(tetX_set, tmp_path):
    images = load(tetX_set)
    (name, model) = classifiers_for(images, [checkpoint_of("small-classifier", tmp_path)])[0]
    assert name == "small-classifier"
    plot_slice([(name, model)], images[0], tmp_path / "slice.png", "z", 20.0)
    assert (tmp_path / "slice.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ModelError, match="is a hypothesis network; a slice is of a classifier"):
        classifiers_for(images, [checkpoint_of("small-wta", tmp_path)])
    other = checkpoint_of("small-classifier", tmp_path)
    other.record.object = "cube"
    with pytest.raises(ModelError, match="was trained on cube"):
        classifiers_for(images, [other])
