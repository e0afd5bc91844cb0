"""Scores that cannot mislead: a mistake of convention or of normalisation is said, and where there is none, nothing."""

from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from bench_sets import small_set
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.hypotheses import HypothesesBlock
from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.bench.predictions.writing.submission import (
    write_classifier,
    write_columns,
    write_density,
    write_hypotheses,
)
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.scorers.hypotheses import ANGLES_DEG, HypothesesScorer
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import quat_wxyz_to_rotation, rotation_to_quat_wxyz, uniform_rotations

IMAGES = {"tetX": 24, "cylO": 12}
D = np.diag([1.0, -1.0, -1.0])
UP = Rotation.from_euler("x", 90, degrees=True).as_matrix()


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    return {name: small_set(folder, name, images) for name, images in IMAGES.items()}


@pytest.fixture(params=list(IMAGES))
def dataset(request, sets):
    return sets[request.param]


def nearly_right(dataset, count, off_rad=0.04, seed=0):
    """Hypotheses of a good method: members that are off by a few degrees."""
    rng, labels = np.random.default_rng(seed), dataset.labels()
    found = []
    for i in range(len(labels)):
        members = labels.symmetry_set(i)
        chosen = members[rng.integers(len(members), size=count)]
        off = Rotation.from_rotvec(rng.normal(scale=off_rad / np.sqrt(3), size=(count, 3))).as_matrix()
        found.append(chosen @ off)
    return np.array(found)


def closeness_to_members(dataset):
    """From an image and rotations (n, 3, 3) to the trace (n,) of what leads to the nearest member: 3 at a member."""
    members = [dataset.labels().symmetry_set(i).reshape(-1, 9) for i in range(len(dataset))]
    return lambda i, R: (R.reshape(-1, 9) @ members[i].T).max(axis=1)


def transposed(R):
    return R.swapaxes(-1, -2)


MISTAKES = {  # how somebody wrote rotations, and the code that the note has to give
    "transposed": (transposed, "R.swapaxes(-1, -2)"),
    "a camera of OpenGL": (lambda R: D @ R, "np.diag([1, -1, -1]) @ R"),
    "both": (lambda R: transposed(D @ R), "np.diag([1, -1, -1]) @ R.swapaxes(-1, -2)"),
    "a model with y up": (lambda R: R @ UP, "R @ Rotation.from_euler('x', -90, degrees=True).as_matrix()"),
    "quaternions with the scalar last": (
        lambda R: quat_wxyz_to_rotation(np.roll(rotation_to_quat_wxyz(R), -1, axis=-1)),
        "quat_wxyz_to_rotation(np.roll(rotation_to_quat_wxyz(R), 1, axis=-1))",
    ),
}


def notes_of(dataset, path, track="hypotheses"):
    return score_file(path, dataset.folder).tracks[track].notes


def notes_on(dataset, R):
    """The notes on hypotheses (N, M, 3, 3) as they are, without a file, and their errors (N,), rad."""
    scorer = HypothesesScorer(SimpleNamespace(count=R.shape[1]), truth_of(dataset))
    table = scorer.score_block(HypothesesBlock(np.arange(len(R)), R, None))
    return scorer.notes(), table.values["precision_mean_error_rad"]


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize(("name", "count"), [("tetX", 30), ("cylO", 1)])
def test_predictions_in_another_convention_are_told_which_and_what_to_write(mistake, name, count, sets):
    to_theirs, code = MISTAKES[mistake]
    theirs = to_theirs(nearly_right(sets[name], count))
    (note,), _ = notes_on(sets[name], theirs)
    assert "is that of rotations that know nothing of the image" in note
    assert f"write {code} in place of the rotations R" in note
    assert ("with the model's y up" in note) is (mistake == "a model with y up")
    names = {"np": np, "R": theirs, "Rotation": Rotation, "quat_wxyz_to_rotation": quat_wxyz_to_rotation}
    notes, errors = notes_on(sets[name], eval(code, {**names, "rotation_to_quat_wxyz": rotation_to_quat_wxyz}))
    assert notes == ()
    assert errors.mean() < 0.06


def test_a_model_with_y_up_is_one_whose_y_is_our_z():
    assert np.allclose(UP @ [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])


def test_a_density_and_a_classifier_in_another_convention_are_told_so(sets, tmp_path):
    dataset, path = sets["tetX"], tmp_path / "preds.h5"
    closeness = closeness_to_members(dataset)
    write_density(path, dataset, lambda i, R: 20 * closeness(i, transposed(R)), method="m", level=2, progress=False)
    write_classifier(path, dataset, lambda i, R: closeness(i, transposed(R)) > 2.9, method="m", level=2, progress=False)
    for track in ("density", "classifier"):
        (note,) = notes_of(dataset, path, track)
        assert "where it is asked about the rotations R, answer about R.swapaxes(-1, -2)" in note
    other = tmp_path / "right.h5"
    write_density(other, dataset, lambda i, R: 20 * closeness(i, R), method="m", level=2, progress=False)
    write_classifier(other, dataset, lambda i, R: closeness(i, R) > 2.9, method="m", level=2, progress=False)
    assert notes_of(dataset, other, "density") == notes_of(dataset, other, "classifier") == ()


@pytest.mark.parametrize(("off_rad", "count"), [(0.01, 1), (0.1, 4), (0.4, 30), (0.4, 1)])
def test_neither_a_good_nor_a_poor_method_nor_a_constant_one_has_a_note(off_rad, count, dataset):
    constant = np.tile(uniform_rotations(count, np.random.default_rng(3)), (len(dataset), 1, 1, 1))
    half = nearly_right(dataset, count, off_rad)
    half[:, count // 2 :] = uniform_rotations(1, np.random.default_rng(4))
    for number, R in enumerate((nearly_right(dataset, count, off_rad), constant, half)):
        assert notes_on(dataset, R)[0] == (), number


def test_a_note_does_not_keep_a_score_from_ranking_and_stands_in_table_and_document(sets, tmp_path):
    dataset, path = sets["tetX"], tmp_path / "preds.h5"
    write_hypotheses(path, dataset, transposed(nearly_right(dataset, 5)), method="mine", progress=False)
    document = report.to_document([score_file(path, dataset.folder)])
    (note,) = document["objects"]["tetX"]["hypotheses"]["notes"]
    assert document["ranks"] is True
    assert " ".join(tables.tables(document).split()).count(f"NOTE: {note}") == 1


# Answers that look normalised


def answers_of(dataset, classify, level):
    """A classifier's answers to the queries (N, Q), and about each image's grid."""
    queries, rotation = Queries(dataset.fingerprint, dataset.symmetry_group), dataset.labels().rotation
    grid, images = equivolumetric_grid(level), range(len(dataset))
    return (
        np.array([classify(i, queries.rotations(i, rotation[i])) for i in images]),
        np.array([classify(i, grid) for i in images]),
    )


def write_answers(path, dataset, answers, level):
    """Write a classifier's answers as they are, past the writer's own checks."""
    asked, on_grid = (each.astype(np.float32) for each in answers)
    listed = [np.flatnonzero(row > np.float32(0.1)) for row in on_grid]
    columns = {
        "query_probability": asked,
        "grid_offsets": np.concatenate([[0], np.cumsum([len(cells) for cells in listed])]),
        "grid_indices": np.concatenate(listed),
        "grid_probabilities": np.concatenate([a[cells] for a, cells in zip(on_grid, listed, strict=True)]),
    }
    write_columns(path, dataset, "classifier", columns, method="mine", grid_level=level, floor=0.1)


def logits(dataset, sharpness):
    near = closeness_to_members(dataset)
    return lambda i, R: sharpness * near(i, R)


@pytest.mark.parametrize(("name", "sharpness"), [("tetX", 1.0), ("tetX", 30.0), ("cylO", 1.0)])
def test_answers_normalised_over_the_queries_are_told_so(name, sharpness, sets, tmp_path):
    """Sharp ones of cylO would be claims, where a set has one member."""
    dataset, path = sets[name], tmp_path / "preds.h5"
    logit = logits(dataset, sharpness)
    write_answers(path, dataset, answers_of(dataset, lambda i, R: softmax(logit(i, R)), 0), 0)
    (note,) = notes_of(dataset, path, "classifier")
    assert "they look normalised over the queries" in note
    assert "divide each image's answers by their largest" in note


def test_answers_normalised_over_the_grid_are_told_so(sets, tmp_path):
    dataset, path, level = sets["tetX"], tmp_path / "preds.h5", 2
    logit, size = logits(dataset, 2.0), 4608
    sums = {}

    def classify(i, R):
        if i not in sums:
            sums[i] = np.exp(logit(i, equivolumetric_grid(level))).sum()
        return np.exp(logit(i, R)) / sums[i]

    write_answers(path, dataset, answers_of(dataset, classify, level), level)
    (note,) = notes_of(dataset, path, "classifier")
    assert "they look normalised over the grid" in note
    assert f"{size:,}" in note


def test_a_probability_per_rotation_has_no_note_however_timid(dataset, tmp_path):
    logit = logits(dataset, 8.0)
    asked, on_grid = answers_of(dataset, lambda i, R: 1 / (1 + np.exp(-(logit(i, R) - 8 * 2.9))), 1)
    for number, scale in enumerate((1.0, 0.5, 1e-2, 0.0)):
        path = tmp_path / f"{number}.h5"
        write_answers(path, dataset, (scale * asked, scale * on_grid), 1)
        assert notes_of(dataset, path, "classifier") == (), scale


# Thresholds


def test_float32_and_float64_hypotheses_have_the_same_shares_where_members_lie_at_the_thresholds(sets, tmp_path):
    dataset = sets["cylO"]
    labels = dataset.labels()

    def every(i):
        return labels.symmetry_set(i)[::12]

    files = {"f8": every, "f4": lambda i: every(i).astype(np.float32)}
    files["made in float32"] = lambda i: (
        labels.rotation[i].astype(np.float32)
        @ (labels.symmetry_group[labels.symmetry_mask[i]][::12].astype(np.float32))
    )
    found = {}
    for name, hypotheses in files.items():
        path = tmp_path / f"{len(found)}.h5"
        write_hypotheses(path, dataset, hypotheses, method="every 12th", progress=False)
        with h5py.File(path) as f:
            assert f["hypotheses"].dtype.str == ("<f8" if name == "f8" else "<f4")
        figures = score_file(path, dataset.folder).tracks["hypotheses"].figures["all"]
        shares = ("coverage", "coverage_image_mean", "accuracy", "f_measure")
        found[name] = [figures[f"{share}_at_{t}_deg"].value for share in shares for t in ANGLES_DEG]
    assert found["f4"] == found["made in float32"] == found["f8"]


def test_rotations_off_by_as_much_as_a_file_may_be_have_the_angles_of_the_nearest_ones(sets, tmp_path):
    dataset = sets["tetX"]
    labels = dataset.labels()
    rng = np.random.default_rng(0)
    R = nearly_right(dataset, 5, off_rad=0.2)
    strain = rng.uniform(-1, 1, size=R.shape)
    off = R @ (np.eye(3) + 1.5e-5 * (strain + transposed(strain)))
    scores = []
    for name, rotations in (("exact", R), ("off", off)):
        write_hypotheses(tmp_path / f"{name}.h5", dataset, rotations, method="mine", progress=False)
        scores.append(score_file(tmp_path / f"{name}.h5", dataset.folder).tracks["hypotheses"].per_image.values)
    for metric in ("recall_mean_error_rad", "precision_mean_error_rad"):
        assert np.abs(scores[0][metric] - scores[1][metric]).max() < 1e-8
    assert len(truth_of(dataset)) == len(labels)


# Listing everything


def test_many_guesses_of_small_weight_do_not_raise_what_ranks(sets, tmp_path):
    dataset = sets["tetX"]
    labels = dataset.labels()
    good = nearly_right(dataset, 9, off_rad=0.02)
    rng = np.random.default_rng(1)
    many = np.concatenate([labels.rotation[:, None], uniform_rotations(24 * 500, rng).reshape(24, 500, 3, 3)], axis=1)
    everything = np.concatenate([many, labels.rotation[:, None] @ labels.symmetry_group], axis=1)
    weights = np.full(everything.shape[:2], 1e-30)
    weights[:, 0] = 1.0
    write_hypotheses(tmp_path / "good.h5", dataset, good, method="good", progress=False)
    write_hypotheses(tmp_path / "all.h5", dataset, everything, method="all", weights=weights, progress=False)
    fair, unfair = (score_file(tmp_path / n, dataset.folder).tracks["hypotheses"] for n in ("good.h5", "all.h5"))
    assert unfair.figures["all"]["f_measure_at_5_deg"].value == 1.0  # the accuracy is that of one hypothesis
    assert unfair.figures["all"]["f_measure_unweighted_at_5_deg"].value < 0.1
    assert fair.figures["all"]["f_measure_at_5_deg"].value > 0.5
