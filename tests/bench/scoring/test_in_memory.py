"""Scoring in memory gives what the same predictions get as a file, to the bit, and refuses what a file may not hold."""

import numpy as np
import pytest
from bench_sets import small_set
from made_sets import make_set

import symsol_annot
from symsol_annot.bench.predictions.writing.submission import (
    write_classifier,
    write_columns,
    write_density,
    write_hypotheses,
)
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import NotAnnotatedError, PredictionsError, RotationError, ScoresError, SettingsError
from symsol_annot.rotations.grid import grid_sha256, grid_size
from symsol_annot.rotations.so3 import rotation_to_quat_wxyz, uniform_rotations

IMAGES = 24


@pytest.fixture(scope="module")
def test(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="module")
def hypotheses():
    return uniform_rotations(IMAGES * 5, np.random.default_rng(1)).reshape(IMAGES, 5, 3, 3)


def assert_same(scores, path, dataset):
    """Every figure, interval, column, fact, warning and note is the file's."""
    of_file = report.to_document([score_file(path, dataset.folder)])
    mine = scores.document()
    for document in (of_file, mine):
        del document["objects"]["tetX"]["predictions"]
    assert mine == {**of_file, "method": mine["method"]}
    for name, track in score_file(path, dataset.folder).tracks.items():
        for metric, values in track.per_image.values.items():
            assert scores.per_image[name][metric].tobytes() == values.tobytes()
        assert scores.tracks[name].figures["all"].keys() == track.figures["all"].keys()
        for stratum, figures in track.figures.items():
            found = scores.tracks[name].figures[stratum]
            assert repr(found) == repr(figures)  # repr of a float gives its bits back


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_an_array_scores_as_its_file(test, hypotheses, tmp_path, dtype):
    given = hypotheses.astype(dtype)
    before = given.copy()
    scores = symsol_annot.score(given, test)
    write_hypotheses(tmp_path / "preds.h5", test, given, method="mine")
    assert_same(scores, tmp_path / "preds.h5", test)
    assert np.array_equal(given, before)  # rounding is taken out of a copy


def test_a_tensor_scores_as_the_array_in_it(test, hypotheses):
    torch = pytest.importorskip("torch")
    tensor = torch.tensor(hypotheses, requires_grad=True)
    as_tensor, as_array = (symsol_annot.score(given, test).document() for given in (tensor, hypotheses))
    assert as_tensor == as_array
    rows = [torch.tensor(rows) for rows in hypotheses]
    assert symsol_annot.score(rows, test).document() == as_array


def test_weights_score_as_in_a_file(test, hypotheses, tmp_path):
    weights = np.random.default_rng(2).random((IMAGES, 5))
    weights[3, 1:] = 0
    scores = symsol_annot.score(hypotheses, test, weights=weights)
    write_hypotheses(tmp_path / "preds.h5", test, hypotheses, method="mine", weights=weights)
    assert_same(scores, tmp_path / "preds.h5", test)
    by_name = {"hypotheses": hypotheses, "hypothesis_weights": weights}
    assert symsol_annot.score(by_name, test).document() == scores.document()
    assert scores.tracks["hypotheses"].headline.metric == "f_measure_unweighted_at_5_deg"


def test_a_ragged_list_and_a_callable_score_as_the_file_that_a_callable_writes(test, hypotheses, tmp_path):
    rows = [hypotheses[i, : 1 + i % 5] for i in range(IMAGES)]
    write_hypotheses(tmp_path / "preds.h5", test, rows.__getitem__, method="mine")
    for given in (rows, tuple(rows), rows.__getitem__, {"hypotheses": rows}, {"hypotheses": rows.__getitem__}):
        assert_same(symsol_annot.score(given, test), tmp_path / "preds.h5", test)


def probability(i, R):
    return np.where(i % 3, 0.5 + 0.5 * np.sin(5 * R[:, 0, 0]), 0.0)


def log_density(i, R):
    return 3.0 * R[:, 1, 1] * np.cos(i)


def test_classifier_and_density_score_as_their_file(test, hypotheses, tmp_path):
    path = tmp_path / "preds.h5"
    write_hypotheses(path, test, hypotheses, method="mine")
    write_classifier(path, test, probability, method="mine", level=1)
    write_density(path, test, log_density, method="mine", level=1)
    given = {"density": log_density, "hypotheses": hypotheses, "classifier": probability}
    scores = symsol_annot.score(given, test, level=1)
    assert list(scores.tracks) == ["hypotheses", "classifier", "density"]
    assert_same(scores, path, test)
    alone = symsol_annot.score(probability, test, track="classifier", level=1)
    assert alone["classifier"] == scores["classifier"]


def test_arrays_in_the_files_form_score_as_their_file(test, tmp_path):
    cells = grid_size(0)
    columns = {
        "density_offsets": np.arange(IMAGES + 1) * 2,
        "density_indices": np.tile([3, cells - 1], IMAGES),
        "density_log_probabilities": np.log(np.tile([0.5, 0.25], IMAGES)),
    }
    write_columns(tmp_path / "preds.h5", test, "density", columns, method="mine", grid_level=0)
    scores = symsol_annot.score({**columns, "grid_level": 0}, test)
    assert_same(scores, tmp_path / "preds.h5", test)
    of_numpy = symsol_annot.score({**columns, "grid_level": np.int64(0), "grid_sha256": np.array(grid_sha256(0))}, test)
    assert of_numpy["density"] == scores["density"]


def test_the_truth_is_perfect_and_a_slice_is_scored_by_its_own_images(test):
    perfect = symsol_annot.score([sample.symmetry_set.members for sample in test], test)
    assert perfect["hypotheses"]["coverage_at_1_deg"] == perfect["hypotheses"]["accuracy_at_1_deg"] == 1.0
    part = symsol_annot.score([sample.symmetry_set.members for sample in test[5:9]], test[5:9])
    assert part.image_index.tolist() == [5, 6, 7, 8]
    assert part["hypotheses"]["coverage_at_1_deg"] == 1.0
    with pytest.raises(ScoresError, match="of 4 images of the test split"):
        part.document()
    with pytest.raises(SettingsError, match="is a slice; a classifier"):
        symsol_annot.score(probability, test[5:9], track="classifier")


# What the scores show


def test_scores_show_the_table_and_give_figures_by_name(test, hypotheses, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    scores = symsol_annot.score(hypotheses, test, method="mine")
    assert repr(scores).startswith("tetX, test split, 24 images: mine\n  hypotheses: F-measure at 5 deg ")
    assert max(map(len, repr(scores).splitlines())) <= 90
    assert "[" not in repr(scores)
    assert "[" in scores.table(intervals=True)
    figure = scores.figure("hypotheses", "recall_mean_error_rad", "hidden")
    assert figure.low < figure.value < figure.high or figure.images < 20
    assert scores["hypotheses"]["recall_mean_error_rad"] == scores.figures["hypotheses"]["recall_mean_error_rad"]
    assert scores.headline == {"hypotheses": scores["hypotheses"]["f_measure_at_5_deg"]}
    for words, hint in (
        (("hypothesis", "f_measure_at_5_deg"), "did you mean 'hypotheses'"),
        (("hypotheses", "f_measure_at_5_degrees"), "did you mean 'f_measure_at_5_deg'"),
        (("hypotheses", "f_measure_at_5_deg", "hiden"), "did you mean 'hidden'"),
    ):
        with pytest.raises(ScoresError, match=hint):
            scores.figure(*words)
    scores.save(tmp_path / "scores.json")
    assert report.to_json(scores.document()) == (tmp_path / "scores.json").read_text()


def test_the_worst_images_are_those_with_the_lowest_figure(test):
    right = [sample.symmetry_set.members[:3] for sample in test]
    right[7] = right[7] @ np.diag([1.0, -1.0, -1.0])
    right[13] = right[13] @ np.diag([-1.0, -1.0, 1.0])
    scores = symsol_annot.score(right, test)
    values = scores.per_image["hypotheses"]["f_measure_at_5_deg"]
    assert {7, 13} >= set(scores.worst("hypotheses", 2))
    assert scores.worst("hypotheses") == np.argsort(values, kind="stable")[:10].tolist()


def test_without_intervals_the_figures_stay(test, hypotheses):
    scores, without = (symsol_annot.score(hypotheses, test, intervals=wanted) for wanted in (True, False))
    assert scores.figures == without.figures
    assert np.isnan(without.figure("hypotheses", "recall_mean_error_rad").low)
    assert np.isfinite(scores.figure("hypotheses", "recall_mean_error_rad").low)


# What is refused


FORMS = {
    "quaternions": rotation_to_quat_wxyz,
    "poses": lambda R: np.pad(R, [(0, 0), (0, 0), (0, 1), (0, 1)]),
    "flat": lambda R: R.reshape(*R.shape[:2], 9),
    "six numbers": lambda R: np.concatenate([R[..., 0], R[..., 1]], -1),
    "swapped": lambda R: np.swapaxes(R, 0, 1),
    "one too many axes": lambda R: R[:, None],
    "one hypothesis": lambda R: R[:, 0],
    "half": lambda R: R.astype(np.float16),
    "complex": lambda R: R.astype(np.complex128),
    "ragged quaternions": lambda R: [rotation_to_quat_wxyz(r[: 1 + i % 5]) for i, r in enumerate(R)],
    "a list in half": lambda R: list(R.astype(np.float16)),
    "a ragged list in half": lambda R: [r[: 1 + i % 5].astype(np.float16) for i, r in enumerate(R)],
    "a callable in half": lambda R: lambda i: R[i].astype(np.float16),
    "a list of scaled ones": lambda R: list(1.01 * R),
    "by image": lambda R: dict(enumerate(R)),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_line_that_ends_the_message_mends_a_wrong_form(test, hypotheses, form):
    predictions = FORMS[form](hypotheses)
    with pytest.raises((SettingsError, PredictionsError, RotationError)) as caught:
        symsol_annot.score(predictions, test)
    names = {"predictions": predictions}
    exec(str(caught.value).splitlines()[-1].strip(), names)
    right = hypotheses[:, :1] if form == "one hypothesis" else hypotheses
    mended = symsol_annot.score(names["predictions"], test)
    if "ragged" in form:
        right = [r[: 1 + i % 5] for i, r in enumerate(hypotheses)]
    expected = symsol_annot.score(right, test)
    assert mended["hypotheses"] == pytest.approx(expected["hypotheses"], abs=2e-3)


def two_arguments(i, R):
    return np.zeros(len(R))


REFUSED = {
    "nothing": (None, "predictions: expected an array of numbers"),
    "words": ("preds.npz", "predictions"),
    "a number": (3.0, "predictions: expected an array, found the number"),
    "too few images": (np.tile(np.eye(3), (3, 2, 1, 1)), "expected"),
    "no hypotheses": (np.zeros((IMAGES, 0, 3, 3)), "M = 0"),
    "an odd name": ({"hypothesis": 3}, "did you mean 'hypotheses'"),
    "an empty dict": ({}, "the dict is empty"),
    "which track": (two_arguments, 'track="classifier"'),
    "texts": ([["a"]] * IMAGES, "expected an array of numbers"),
    "not above the floor": ({"query_probability": np.zeros((IMAGES, 5))}, "'query_probability': expected"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_predictions_is_refused_in_one_error(test, what):
    given, words = REFUSED[what]
    with pytest.raises((SettingsError, PredictionsError)) as caught:
        symsol_annot.score(given, test)
    assert words in str(caught.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_all_rows_that_are_no_rotations_are_named(test, hypotheses, value):
    broken = hypotheses.copy()
    broken[[3, 8], 1] = np.full((3, 3), value)
    with pytest.raises(PredictionsError, match=r"rows 3.*, 8"):
        symsol_annot.score(broken, test)
    with pytest.raises(RotationError, match="image 3"):
        symsol_annot.score(list(broken), test)


def test_no_split_is_refused_with_the_line_that_opens_one(test, hypotheses):
    with pytest.raises(SettingsError, match=r"symsol_annot\.load"):
        symsol_annot.score(hypotheses, str(test.folder))
    with pytest.raises(SettingsError, match=r"expected what symsol_annot\.load returns, found ndarray$"):
        symsol_annot.score(hypotheses, hypotheses)
    with pytest.raises(SettingsError, match="did you mean 'density'"):
        symsol_annot.score(log_density, test, track="densty")
    with pytest.raises(SettingsError, match="weights"):
        symsol_annot.score(lambda i: hypotheses[i], test, weights=np.ones((IMAGES, 5)))


def test_a_split_without_sets_is_refused(tmp_path, hypotheses):
    folder = make_set(tmp_path, "tetX", train=4, test=0, annotate="test")
    with pytest.raises(NotAnnotatedError):
        symsol_annot.score(hypotheses[:4], symsol_annot.load(folder, "train"))
