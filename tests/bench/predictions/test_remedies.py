"""Refusals that say the line that mends: each line is run on what was refused, and what it makes is written."""

from collections.abc import Mapping

import h5py
import numpy as np
import pytest
import torch
from bench_sets import small_set
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.advice.answer_remedies import fault_of_log_densities, is_normalised
from symsol_annot.bench.predictions.advice.remedies import six_numbers_to_rotation
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.grid import (
    e3nn_to_grid_frame,
    equivolumetric_grid,
    grid_frame_to_e3nn,
    implicit_pdf_to_grid_frame,
)
from symsol_annot.rotations.so3 import angle_between, rotation_deviation, rotation_to_quat_wxyz, uniform_rotations

IMAGES, M, LEVEL = 12, 5, 1
CELLS = 576
R = uniform_rotations(IMAGES * M, np.random.default_rng(0)).reshape(IMAGES, M, 3, 3)


@pytest.fixture(scope="module")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="module")
def members(tetX):
    labels = tetX.labels()
    return [labels.symmetry_set(i) for i in range(IMAGES)]


def line_of(refused):
    """The last line of a message, which is the code."""
    said = str(refused.value).splitlines()
    assert "; this line " in said[-2], said
    return said[-1].strip()


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
def test_the_line_for_an_array_mends_it(tetX, tmp_path, form):
    given, tolerance = FORMS[form][0](R), FORMS[form][1]
    check_array(tetX, tmp_path, given, R, tolerance)


def check_array(dataset, tmp_path, given, expected, tolerance):
    with pytest.raises((SettingsError, PredictionsError)) as refused:
        write_hypotheses(tmp_path / "preds.h5", dataset, given, method="mine")
    assert list(tmp_path.iterdir()) == []
    names = {"hypotheses": given}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", dataset, names["hypotheses"], method="mine")
    assert angle_between(written(tmp_path / "preds.h5"), expected).max() <= tolerance


@every_form
def test_the_line_for_a_callable_mends_it(tetX, tmp_path, form):
    give, tolerance = FORMS[form]
    check_callable(tetX, tmp_path, lambda i: give(R[i]), R, tolerance)


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
def test_the_line_for_one_hypothesis_per_image_mends_it(tetX, tmp_path, form):
    (tmp_path / "array").mkdir(), (tmp_path / "callable").mkdir()
    one = R[:, 0]
    check_array(tetX, tmp_path / "array", ONE[form](one), R[:, :1], 1e-12)
    check_callable(tetX, tmp_path / "callable", lambda i: ONE[form](one[i]), R[:, :1], 1e-12)


def test_images_along_the_second_axis_are_put_first(tetX, tmp_path):
    check_array(tetX, tmp_path, np.swapaxes(R, 0, 1), R, 1e-12)


def test_whole_numbers_are_mended_where_they_are_rotations(tetX, tmp_path):
    quarter_turns = np.tile(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), (IMAGES, 2, 1, 1))
    check_array(tetX, tmp_path, quarter_turns, quarter_turns, 0.0)


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
def test_rows_of_different_lengths_are_mended(tetX, tmp_path, given):
    with pytest.raises(SettingsError, match="hypotheses: expected ") as refused:
        write_hypotheses(tmp_path / "preds.h5", tetX, given, method="mine")
    names = {"hypotheses": given}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", tetX, names["hypotheses"], method="mine")
    for i in range(IMAGES):
        assert np.array_equal(written(tmp_path / "preds.h5")[i, : 1 + i % M], R[i, : 1 + i % M])


def test_a_list_of_tensors_with_gradients_is_mended(tetX, tmp_path):
    check_array(tetX, tmp_path, [torch.tensor(of_image, requires_grad=True) for of_image in R], R, 1e-12)


def test_scipys_rotations_are_mended(tetX, tmp_path):
    check_callable(tetX, tmp_path, lambda i: Rotation.from_matrix(R[i]), R, 1e-12)


@pytest.mark.parametrize("form", ["npy", "npz", "npz of another name", "pt"])
def test_a_path_in_place_of_an_array_is_mended(tetX, tmp_path, form):
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
            write_hypotheses(tmp_path / "preds.h5", tetX, given, method="mine")
        names = {"hypotheses": given}
        exec(line_of(refused), names)
        write_hypotheses(tmp_path / "preds.h5", tetX, names["hypotheses"], method="mine")
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
def test_what_no_line_mends_is_refused_without_one(tetX, tmp_path, given):
    with pytest.raises((SettingsError, PredictionsError)) as refused:
        write_hypotheses(tmp_path / "preds.h5", tetX, given, method="mine")
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


def test_weights_with_a_gradient_are_mended(tetX, tmp_path):
    weights = torch.ones((IMAGES, M), requires_grad=True)
    with pytest.raises(SettingsError, match="hypothesis_weights: ") as refused:
        write_hypotheses(tmp_path / "preds.h5", tetX, R, weights=weights, method="mine")
    names = {"hypothesis_weights": weights}
    exec(line_of(refused), names)
    write_hypotheses(tmp_path / "preds.h5", tetX, R, weights=names["hypothesis_weights"], method="mine")


def test_a_folder_in_place_of_a_split_is_mended(tetX, tmp_path):
    with pytest.raises(SettingsError, match="dataset: expected a split, found str") as refused:
        write_hypotheses(tmp_path / "preds.h5", str(tetX.folder), R, method="mine")
    names = {}
    exec(line_of(refused), names)
    with names["dataset"] as opened:
        write_hypotheses(tmp_path / "preds.h5", opened, R, method="mine")


# --- rotations of float32 networks ---


def gram_schmidt(rng, n):
    x, y = rng.normal(size=(2, n, 3)).astype(np.float32)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y -= (x * y).sum(-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def from_quaternions(rng, n):
    q = rng.normal(size=(n, 4)).astype(np.float32)
    w, x, y, z = (q / np.linalg.norm(q, axis=-1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def by_svd(rng, n):
    left, _, right = np.linalg.svd(rng.normal(size=(n, 3, 3)).astype(np.float32))
    left[..., -1] *= np.sign(np.linalg.det(left @ right)).astype(np.float32)[:, None]
    return left @ right


@pytest.mark.parametrize("network", [gram_schmidt, from_quaternions, by_svd])
@pytest.mark.parametrize(
    "then",
    [
        lambda R: R,
        lambda R: R.astype(np.float64),
        implicit_pdf_to_grid_frame,
        e3nn_to_grid_frame,
        grid_frame_to_e3nn,
        lambda R: implicit_pdf_to_grid_frame(R.astype(np.float64)),
        lambda R: uniform_rotations(1, np.random.default_rng(1))[0] @ R,
    ],
    ids=["as it is", "float64", "implicit_pdf", "e3nn", "to e3nn", "float64 implicit_pdf", "turned in float64"],
)
def test_rotations_of_float32_networks_are_accepted_in_either_type_and_every_frame(tetX, tmp_path, network, then):
    made = network(np.random.default_rng(0), IMAGES * 5000).reshape(IMAGES, 5000, 3, 3)
    assert made.dtype == np.float32
    write_hypotheses(tmp_path / "preds.h5", tetX, then(made), method="mine")
    with h5py.File(tmp_path / "preds.h5") as file:
        assert file["hypotheses"].dtype == then(made).dtype


@pytest.mark.parametrize("convert", [implicit_pdf_to_grid_frame, e3nn_to_grid_frame])
def test_frames_keep_the_type_and_each_number(convert):
    made = by_svd(np.random.default_rng(0), 50)
    for dtype in (np.float16, np.float32, np.float64, np.longdouble):
        turned = convert(made.astype(dtype))
        assert turned.dtype == dtype
        assert np.array_equal(np.sort(turned, axis=None), np.sort(made.astype(dtype), axis=None))
    with pytest.raises(RotationError, match=r"expected an array of shape \(\.\.\., 3, 3\), found \(50, 9\)"):
        convert(made.reshape(50, 9))


# --- classifiers ---


def logits(members):
    """Above 0 near a member."""
    return lambda i, R: 40.0 * (angle_between(R[:, None], members[i][None]).min(axis=1) < 0.4) - 20.0 + R[:, 0, 0]


@pytest.mark.parametrize(
    "given",
    [
        lambda f: f,
        lambda f: lambda i, R: f(i, R).astype(np.float32),
        lambda f: lambda i, R: 1.005 * (f(i, R) > 0),
        lambda f: lambda i, R: torch.tensor(1.0 * (f(i, R) > 0), requires_grad=True),
        lambda f: lambda i, R: torch.tensor(1.0 * (f(i, R) > 0)).bfloat16(),
        lambda f: lambda i, R: (f(i, R) > 0)[:, None],
        lambda f: lambda i, R: (f(i, R) > 0)[None],
        lambda f: lambda i, R: (f(i, R) > 0).astype(complex),
    ],
    ids=["logits", "float32", "rounding", "gradient", "bfloat16", "(n, 1)", "(1, n)", "complex"],
)
def test_the_line_for_a_classifier_mends_it(tetX, members, tmp_path, given):
    classify = given(logits(members))
    with pytest.raises(SettingsError, match="image 0: ") as refused:
        write_classifier(tmp_path / "preds.h5", tetX, classify, method="mine", level=LEVEL)
    names = {"classify": classify}
    exec(line_of(refused), names)
    write_classifier(tmp_path / "preds.h5", tetX, names["classify"], method="mine", level=LEVEL)
    figures = score_file(tmp_path / "preds.h5", tetX.folder).tracks["classifier"].figures["all"]
    assert figures["recall"].value == 1.0


@pytest.mark.parametrize("batch_size", [100, 10**6])
def test_a_classifier_that_is_normalised_over_what_it_is_asked_is_a_density(tetX, members, tmp_path, batch_size):
    def softmax(i, R):
        p = np.exp(0.2 * logits(members)(i, R))
        return p / p.sum()

    with pytest.raises(SettingsError, match="image 0: the answers add up to 1 over the rotations asked") as refused:
        write_classifier(tmp_path / "no.h5", tetX, softmax, method="mine", level=LEVEL, batch_size=batch_size)
    path = tmp_path / "preds.h5"
    exec(line_of(refused), {"path": path, "dataset": tetX, "classify": softmax, "method": "mine"})
    figures = score_file(path, tetX.folder).tracks["density"].figures["all"]
    assert figures["log_likelihood"].value > 1.0


@pytest.mark.parametrize("answers", [np.eye(108)[3], np.zeros(108), np.full(108, 0.5), np.eye(108)[3] + np.eye(108)[9]])
def test_one_certain_answer_is_not_taken_for_a_softmax(answers):
    assert not is_normalised(answers, 50)
    assert not is_normalised(answers, 108)


def test_an_array_in_place_of_a_classifier_is_refused(tetX, tmp_path):
    with pytest.raises(SettingsError, match=r"classify: expected a callable, found ndarray; .* go to write_columns"):
        write_classifier(tmp_path / "preds.h5", tetX, np.zeros((IMAGES, CELLS)), method="mine", level=LEVEL)


# --- densities ---


def log_density(members):
    return lambda i, R: -5.0 * angle_between(R[:, None], members[i][None]).min(axis=1)


def normalised(log_p):
    return log_p - np.logaddexp.reduce(log_p)


BATCH = 100
DENSITIES = {
    "probabilities": lambda f: lambda i, R: np.exp(normalised(f(i, R))),
    "probabilities with zeros": lambda f: lambda i, R: (p := np.maximum(np.exp(f(i, R)) - 0.1, 0.0)) / p.sum(),
    "infinity": lambda f: lambda i, R: np.where(f(i, R) > -2.5, np.inf, f(i, R)),
    "gradient": lambda f: lambda i, R: torch.tensor(f(i, R), requires_grad=True),
    "(n, 1)": lambda f: lambda i, R: f(i, R)[:, None],
}


@pytest.mark.parametrize("form", DENSITIES)
def test_the_line_for_a_density_mends_it(tetX, members, tmp_path, form):
    given = DENSITIES[form](log_density(members))
    with pytest.raises(SettingsError, match="image 0: ") as refused:
        write_density(tmp_path / "preds.h5", tetX, given, method="mine", level=LEVEL)
    names = {"log_density": given}
    exec(line_of(refused), names)
    write_density(tmp_path / "preds.h5", tetX, names["log_density"], method="mine", level=LEVEL)
    assert likelihood(tmp_path / "preds.h5", tetX) > 0.5


def likelihood(path, dataset):
    return score_file(path, dataset.folder).tracks["density"].figures["all"]["log_likelihood"].value


@pytest.mark.parametrize("volume", [1.0, np.pi**2, 8 * np.pi**2])
def test_a_density_over_the_volume_of_so3_is_told_from_logarithms(members, volume):
    log_p = normalised(-60.0 * angle_between(equivolumetric_grid(LEVEL), members[0][0]))
    values = np.exp(log_p) * CELLS / volume
    assert "these look like probabilities" in fault_of_log_densities(values, BATCH, LEVEL)


@pytest.mark.parametrize("given", [lambda log_p: log_p, np.exp], ids=["logarithms", "probabilities"])
def test_what_is_normalised_in_each_batch_is_asked_about_the_whole_grid(tetX, members, tmp_path, given):
    """Its constants differ from batch to batch, so that batches cannot be compared."""
    path, whole = tmp_path / "preds.h5", log_density(members)

    def of_batch(i, R):
        return given(normalised(whole(i, R)))

    with pytest.raises(SettingsError, match=r"image 0: .* add up to 1 in each batch") as refused:
        write_density(tmp_path / "no.h5", tetX, of_batch, method="mine", level=LEVEL, batch_size=BATCH)
    exec(line_of(refused), {"path": path, "dataset": tetX, "log_density": of_batch, "method": "mine"})
    write_density(tmp_path / "right.h5", tetX, whole, method="mine", level=LEVEL)
    assert likelihood(path, tetX) == pytest.approx(likelihood(tmp_path / "right.h5", tetX), abs=0.01)


def test_an_array_in_place_of_a_density_is_mended(tetX, members, tmp_path):
    given = np.stack([log_density(members)(i, equivolumetric_grid(LEVEL)) for i in range(IMAGES)])
    with pytest.raises(SettingsError, match="log_density: expected a callable, found ndarray") as refused:
        write_density(tmp_path / "no.h5", tetX, given, method="mine", level=LEVEL)
    path = tmp_path / "preds.h5"
    exec(line_of(refused), {"path": path, "dataset": tetX, "log_density": given, "method": "mine"})
    assert likelihood(path, tetX) > 0.5


@pytest.mark.parametrize(
    "log_p",
    [
        np.zeros(CELLS),
        np.full(CELLS, 1.0 / CELLS),
        np.ones(CELLS),
        np.linspace(0.0, 2.0, CELLS),
        normalised(np.linspace(-9.0, 0.0, CELLS)),
        np.linspace(1e5, 2e5, CELLS),
        np.where(np.arange(CELLS) == 3, 0.0, -np.inf),
    ],
    ids=["zero", "flat and adding up to 1", "ones", "energies of mean 1", "normalised as a whole", "huge", "one cell"],
)
def test_log_densities_are_not_taken_for_anything_else(log_p):
    assert fault_of_log_densities(log_p, BATCH, LEVEL) == ""
