"""Hypotheses in another form are refused with a line of code, and the line mends them."""

from collections.abc import Mapping

import h5py
import numpy as np
import pytest
import torch
from remedy_lines import IMAGES, M, R, line_of
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.advice.remedies import six_numbers_to_rotation
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.errors import PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.so3 import angle_between, rotation_deviation, rotation_to_quat_wxyz


def poses(R):
    homogeneous = np.zeros((*R.shape[:-2], 4, 4), R.dtype)
    homogeneous[..., :3, :3], homogeneous[..., 3, 3], homogeneous[..., 2, 3] = R, 1.0, 7.0
    return homogeneous


def rotation_vectors(R):
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(*R.shape[:-2], 3)


def six_numbers(R):
    return np.concatenate([3.0 * R[..., 0], R[..., 1] + 0.3 * R[..., 0]], axis=-1)


FORMS = {  # what a form is, and how far off the rotations may be that come of it
    "4x4 poses": (poses, 1e-12),
    "3x4 poses": (lambda R: poses(R)[..., :3, :], 1e-12),
    "flat 4x4 poses": (lambda R: poses(R).reshape(*R.shape[:-2], 16), 1e-12),
    "nine numbers": (lambda R: R.reshape(*R.shape[:-2], 9), 1e-12),
    "quaternions": (rotation_to_quat_wxyz, 1e-12),
    "float32 quaternions": (lambda R: rotation_to_quat_wxyz(R).astype(np.float32), 1e-5),
    "rotation vectors": (rotation_vectors, 1e-12),
    "six numbers": (six_numbers, 1e-12),
    "float32 six numbers": (lambda R: six_numbers(R).astype(np.float32), 1e-5),
    "float16": (lambda R: R.astype(np.float16), 1e-2),
    "complex": (lambda R: R.astype(complex), 1e-12),
    "longdouble": (lambda R: R.astype(np.longdouble), 1e-12),
    "off by 0.001": (lambda R: R * (1 + 1e-3), 1e-12),
    "rounded to two decimals": (lambda R: R.round(2), 3e-2),
    "float16 poses": (lambda R: poses(R).astype(np.float16), 1e-2),
    "a tensor that requires a gradient": (lambda R: torch.tensor(R, requires_grad=True), 1e-12),
    "a tensor of bfloat16": (lambda R: torch.tensor(R).bfloat16(), 3e-2),
    "a tensor of quaternions with a gradient": (
        lambda R: torch.tensor(rotation_to_quat_wxyz(R), requires_grad=True),
        1e-12,
    ),
    "an axis of length 1": (lambda R: np.expand_dims(R, -4), 1e-12),
}
every_form = pytest.mark.parametrize("form", FORMS)


def written(path):
    with h5py.File(path) as file:
        return file["hypotheses"][...].astype(np.float64)


@every_form
def test_the_line_for_an_array_mends_it(dozen, tmp_path, form):
    given, tolerance = FORMS[form][0](R), FORMS[form][1]
    check_array(dozen, tmp_path, given, R, tolerance)


def check_array(dataset, tmp_path, given, expected, tolerance):
    with pytest.raises((SettingsError, PredictionsError)) as refused:
        write_hypotheses(tmp_path / "preds.h5", dataset, given, method="mine")
    assert list(tmp_path.iterdir()) == []
    names = {"hypotheses": given}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", dataset, names["hypotheses"], method="mine")
    assert angle_between(written(tmp_path / "preds.h5"), expected).max() <= tolerance


@every_form
def test_the_line_for_a_callable_mends_it(dozen, tmp_path, form):
    give, tolerance = FORMS[form]
    check_callable(dozen, tmp_path, lambda i: give(R[i]), R, tolerance)


def check_callable(dataset, tmp_path, given, expected, tolerance):
    with pytest.raises((SettingsError, RotationError), match="hypotheses of image 0: ") as refused:
        write_hypotheses(tmp_path / "preds.h5", dataset, given, method="mine")
    names = {"hypotheses": given}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", dataset, names["hypotheses"], method="mine")
    assert angle_between(written(tmp_path / "preds.h5"), expected).max() <= tolerance


ONE = {  # a hypothesis per image, without the axis of hypotheses
    "matrices": lambda R: R,
    "4x4 poses": poses,
    "nine numbers": lambda R: R.reshape(*R.shape[:-2], 9),
    "quaternions": rotation_to_quat_wxyz,
    "rotation vectors": rotation_vectors,
    "six numbers": six_numbers,
}


@pytest.mark.parametrize("form", ONE)
def test_the_line_for_one_hypothesis_per_image_mends_it(dozen, tmp_path, form):
    (tmp_path / "array").mkdir(), (tmp_path / "callable").mkdir()
    one = R[:, 0]
    check_array(dozen, tmp_path / "array", ONE[form](one), R[:, :1], 1e-12)
    check_callable(dozen, tmp_path / "callable", lambda i: ONE[form](one[i]), R[:, :1], 1e-12)


def test_images_along_the_second_axis_are_put_first(dozen, tmp_path):
    check_array(dozen, tmp_path, np.swapaxes(R, 0, 1), R, 1e-12)


def test_whole_numbers_are_mended_where_they_are_rotations(dozen, tmp_path):
    quarter_turns = np.tile(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), (IMAGES, 2, 1, 1))
    check_array(dozen, tmp_path, quarter_turns, quarter_turns, 0.0)


class Rows(Mapping):
    """Rows by the image's index, in no order."""

    def __getitem__(self, i):
        return R[i, : 1 + i % M]

    def __iter__(self):
        return iter(range(IMAGES)[::-1])

    def __len__(self):
        return IMAGES


@pytest.mark.parametrize(
    "given",
    [[R[i, : 1 + i % M] for i in range(IMAGES)], {i: R[i, : 1 + i % M] for i in range(IMAGES)}, Rows()],
    ids=["list", "dict", "mapping"],
)
def test_rows_of_different_lengths_are_mended(dozen, tmp_path, given):
    with pytest.raises(SettingsError, match="hypotheses: expected ") as refused:
        write_hypotheses(tmp_path / "preds.h5", dozen, given, method="mine")
    names = {"hypotheses": given}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", dozen, names["hypotheses"], method="mine")
    for i in range(IMAGES):
        assert np.array_equal(written(tmp_path / "preds.h5")[i, : 1 + i % M], R[i, : 1 + i % M])


def test_a_list_of_tensors_with_gradients_is_mended(dozen, tmp_path):
    check_array(dozen, tmp_path, [torch.tensor(of_image, requires_grad=True) for of_image in R], R, 1e-12)


def test_scipys_rotations_are_mended(dozen, tmp_path):
    check_callable(dozen, tmp_path, lambda i: Rotation.from_matrix(R[i]), R, 1e-12)


@pytest.mark.parametrize("form", ["npy", "npz", "npz of another name", "pt"])
def test_a_path_in_place_of_an_array_is_mended(dozen, tmp_path, form):
    path = tmp_path / f"it's.{form[:3].strip()}"
    match form:
        case "npy":
            np.save(path, R)
        case "npz":
            np.savez(path, hypotheses=R, other=[1])
        case "npz of another name":
            np.savez(path, R)
        case "pt":
            torch.save(torch.tensor(R), path)
    for given in (path, str(path)):
        with pytest.raises(SettingsError, match="this is a path") as refused:
            write_hypotheses(tmp_path / "preds.h5", dozen, given, method="mine")
        names = {"hypotheses": given}
        exec(line_of(refused), names)
        write_hypotheses(tmp_path / "preds.h5", dozen, names["hypotheses"], method="mine")
        assert np.array_equal(written(tmp_path / "preds.h5"), R)


@pytest.mark.parametrize(
    "given",
    [
        np.zeros((IMAGES, M, 3, 3)),
        -R,
        -R[:, 0],
        np.full((IMAGES, M, 3, 3), np.nan),
        np.full((IMAGES, M, 4), np.nan),
        np.zeros((IMAGES, M, 4)),
        np.zeros((IMAGES, M, 4, 4)),
        100.0 * np.ones((IMAGES, M, 3)),
        np.zeros((IMAGES, M, 6)),
        np.zeros((IMAGES, 0, 3, 3)),
        np.zeros((IMAGES, M, 7)),
        R > 0,
        R[:-1],
        np.array(["a"] * IMAGES),
        None,
        5.0,
        [],
        {},
        "preds.txt",
        object(),
    ],
    ids=lambda given: f"{type(given).__name__} {np.shape(given) if isinstance(given, np.ndarray) else ''}",
)
def test_what_no_line_mends_is_refused_without_one(dozen, tmp_path, given):
    with pytest.raises((SettingsError, PredictionsError)) as refused:
        write_hypotheses(tmp_path / "preds.h5", dozen, given, method="mine")
    assert "this line mends it" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seed", range(3))
def test_six_numbers_are_two_columns_made_orthonormal_in_turn(seed):
    six = np.random.default_rng(seed).normal(size=(4, 5, 6))
    found = six_numbers_to_rotation(six)
    for numbers, of_them in zip(six.reshape(-1, 6), found.reshape(-1, 3, 3), strict=True):
        q, r = np.linalg.qr(numbers.reshape(2, 3).T)
        assert np.allclose(of_them[:, :2], q * np.sign(np.diag(r)), atol=1e-12)
    assert rotation_deviation(found).max() < 1e-12


def test_weights_with_a_gradient_are_mended(dozen, tmp_path):
    weights = torch.ones((IMAGES, M), requires_grad=True)
    with pytest.raises(SettingsError, match="hypothesis_weights: ") as refused:
        write_hypotheses(tmp_path / "preds.h5", dozen, R, weights=weights, method="mine")
    names = {"hypothesis_weights": weights}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", dozen, R, weights=names["hypothesis_weights"], method="mine")


def test_a_folder_in_place_of_a_split_is_mended(dozen, tmp_path):
    with pytest.raises(SettingsError, match="dataset: expected a split, found str") as refused:
        write_hypotheses(tmp_path / "preds.h5", str(dozen.folder), R, method="mine")
    names = {}
    exec(line_of(refused), names)
    with names["dataset"] as opened:
        write_hypotheses(tmp_path / "preds.h5", opened, R, method="mine")
