"""Predictions in other forms: converted, or scored as they are, they get what the predictions file of them gets."""

import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from score_commands import IMAGES

from symsol_annot.bench.predictions.writing.submission import write_density, write_hypotheses
from symsol_annot.rotations.so3 import uniform_rotations

COUNT = IMAGES["tetX"]


@pytest.fixture(scope="module")
def R():
    return uniform_rotations(COUNT * 4, np.random.default_rng(7)).reshape(COUNT, 4, 3, 3)


@pytest.fixture(scope="module")
def expected(R, sets, tmp_path_factory):
    path = tmp_path_factory.mktemp("expected") / "preds.h5"
    write_hypotheses(path, sets["tetX"], R, method="mine")
    return path


def figures(here, path, data, tmp_path):
    done = here("score", path, "--data", data, "--json", tmp_path / "scores.json")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads((tmp_path / "scores.json").read_text())["objects"]["tetX"]
    return {track: found[track]["all"] for track in ("hypotheses", "classifier", "density") if track in found}


def assert_alike(found, wanted):
    assert found.keys() == wanted.keys()
    for track, metrics in wanted.items():
        for metric, figure in metrics.items():
            assert found[track][metric]["value"] == pytest.approx(figure["value"], abs=1e-6), metric


FILES = {
    "quaternions": (
        lambda R: Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(-1, 4, 4),
        ["--order", "xyzw"],
    ),
    "vectors": (
        lambda R: Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(-1, 4, 3),
        ["--form", "rotvec"],
    ),
    "blender": (lambda R: np.diag([1, -1, -1]) @ np.pad(R, [(0, 0)] * 3 + [(0, 1)]), ["--frame", "opengl"]),
    "inverse": (lambda R: np.swapaxes(R, -1, -2), ["--frame", "transposed"]),
}


@pytest.mark.parametrize("name", FILES)
def test_converted_predictions_score_as_those_that_were_written(R, expected, sets, data, here, tmp_path, name):
    make, options = FILES[name]
    np.savez(tmp_path / "mine.npz", R=make(R))
    out = tmp_path / "preds.h5"
    done = here("convert", tmp_path / "mine.npz", "--data", sets["tetX"].folder, "--out", out, *options)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == f"{out}: predictions of 'mine' about {COUNT} images of tetX"
    assert_alike(figures(here, out, data, tmp_path), figures(here, expected, data, tmp_path))


def test_a_table_and_tensors_are_converted(R, expected, sets, data, here, tmp_path):
    torch = pytest.importorskip("torch")
    torch.save({"hypotheses": torch.tensor(R)}, tmp_path / "mine.pt")
    lines = [",".join(map(repr, [i, *map(float, R[i, m].ravel())])) for m in range(4) for i in range(COUNT)]
    (tmp_path / "mine.csv").write_text("\n".join(["image_index," + ",".join("abcdefghi"), *lines]))
    for name in ("mine.pt", "mine.csv"):
        out = tmp_path / f"{name}.h5"
        done = here("convert", tmp_path / name, "--data", data, "--object", "tetX", "--out", out)
        assert (done.returncode, done.stderr) == (0, "")
        assert_alike(figures(here, out, data, tmp_path), figures(here, expected, data, tmp_path))


def test_an_npz_of_matrices_is_scored_as_it_is(R, expected, sets, data, here, tmp_path):
    np.savez(tmp_path / "mine.npz", R=R)
    wanted = figures(here, expected, data, tmp_path)
    assert figures(here, tmp_path / "mine.npz", sets["tetX"].folder, tmp_path) == wanted
    np.savez(tmp_path / "says.npz", R=R, object="tetX", method="mine")
    done = here("score", tmp_path / "says.npz", "--data", data)
    assert done.stdout.startswith("tetX, test split, 24 images: mine\n")
    assert figures(here, tmp_path / "says.npz", data, tmp_path) == wanted


def test_an_npz_in_the_files_form_is_scored_and_converted(sets, data, here, tmp_path):
    write_density(tmp_path / "preds.h5", sets["tetX"], lambda i, R: R[:, 0, 0], method="mine", level=0, floor=1e-9)
    columns = {
        "density_offsets": np.arange(COUNT + 1) * 2,
        "density_indices": np.tile([3, 70], COUNT),
        "density_log_probabilities": np.log(np.tile([0.5, 0.25], COUNT)),
        "grid_level": 0,
    }
    np.savez(tmp_path / "mine.npz", **columns)
    as_it_is = figures(here, tmp_path / "mine.npz", sets["tetX"].folder, tmp_path)
    done = here("convert", tmp_path / "mine.npz", "--data", sets["tetX"].folder, "--out", tmp_path / "mine.h5")
    assert (done.returncode, done.stderr) == (0, "")
    assert figures(here, tmp_path / "mine.h5", data, tmp_path) == as_it_is


REFUSED = {
    "quaternions without an order": (lambda R: {"R": np.ones((COUNT, 4)) / 2}, [], "--order wxyz"),
    "three numbers": (lambda R: {"R": np.ones((COUNT, 3))}, [], "--form rotvec"),
    "an unknown frame": (lambda R: {"R": R}, ["--frame", "opengll"], "did you mean 'opengl'"),
    "two arrays": (lambda R: {"R": R, "Q": R}, [], "--array names it"),
    "an unknown array": (lambda R: {"R": R}, ["--array", "r"], "did you mean 'R'"),
    "too few images": (lambda R: {"R": R[:5]}, [], "expected a row for each of the 24 images"),
    "no rotations": (lambda R: {"R": 2 * R}, [], "row 0: expected rotations"),
    "a frame of a grid": (lambda R: {"density_indices": R}, ["--frame", "opengl"], "these arrays are on the grid"),
    "another name": (lambda R: {"density_ofsets": R, "density_indices": R}, [], "did you mean 'density_offsets'"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_converted_is_one_error_and_leaves_no_file(R, sets, here, tmp_path, what):
    make, options, words = REFUSED[what]
    np.savez(tmp_path / "mine.npz", **make(R))
    done = here("convert", tmp_path / "mine.npz", "--data", sets["tetX"].folder, "--out", tmp_path / "o.h5", *options)
    assert done.returncode in {1, 2}
    assert done.stdout == ""
    assert words in done.stderr
    assert done.stderr.count("Error: ") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.npz"]


def test_score_names_the_command_that_converts_what_it_does_not_take(sets, data, here, tmp_path):
    np.savez(tmp_path / "mine.npz", q=np.ones((COUNT, 1, 4)) / 2)
    done = here("score", tmp_path / "mine.npz", "--data", sets["tetX"].folder)
    assert done.returncode == 1
    assert f"symsol-annot convert {tmp_path / 'mine.npz'} --data {sets['tetX'].folder} --split test" in done.stderr
    several = here("score", tmp_path / "mine.npz", "--data", data)
    assert "holds several sets" in several.stderr


def test_the_package_is_a_command_too():
    done = subprocess.run(
        [sys.executable, "-m", "symsol_annot", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("symsol-annot, version ")
