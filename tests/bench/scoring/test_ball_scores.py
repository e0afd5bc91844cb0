"""Scores of a ball's set, from its shards to the reference rows, through predictions files and in memory."""

import h5py
import numpy as np
import pytest
from balls import MARKED, ball_set

from symsol_annot import load
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.bench.predictions.writing.query_file import write_queries
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.memory.in_memory import score
from symsol_annot.bench.scoring.reference import IN_VOLUME, ROWS, score_row
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError
from symsol_annot.rotations.so3 import uniform_rotations

LEVEL, IMAGES = 1, 16


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return load(ball_set(tmp_path_factory.mktemp("object"), *MARKED, IMAGES))


@pytest.fixture(scope="module")
def filled(dataset):
    """(N,) which images show nothing of the parts."""
    volume = dataset.labels().volume
    assert 2 < (volume >= 0).sum() < IMAGES - 2
    return volume >= 0


@pytest.fixture(scope="module")
def rows(dataset, tmp_path_factory):
    return {name: score_row(name, [dataset], tmp_path_factory.mktemp(name), LEVEL) for name in ROWS}


def value(document, track, metric):
    (scores,) = document["objects"].values()
    return scores[track]["all"][metric]["value"]


def column(document, track, metric):
    (scores,) = document["objects"].values()
    return np.array(scores["per_image"][track][metric], dtype=np.float64)


def test_the_truth_is_a_perfect_classifier_and_density_and_its_hypotheses_are_all_right(rows, filled):
    truth = rows["truth"]
    for metric in ("recall", "precision", "f_measure", "accuracy"):
        assert value(truth, "classifier", metric) == 1.0
    for metric in ("decoy_false_positive_rate", "grid_positive_rate", "hard_negative_rate"):
        assert value(truth, "classifier", metric) == 0.0
    assert value(truth, "density", "log_likelihood") == pytest.approx(value(truth, "density", "log_likelihood_ceiling"))
    assert value(truth, "density", "spread_rad") == pytest.approx(value(truth, "density", "spread_at_ceiling_rad"))
    assert value(truth, "hypotheses", "accuracy_at_5_deg") == 1.0
    assert value(truth, "hypotheses", "precision_mean_error_rad") < 1e-9
    f_measure = column(truth, "hypotheses", "f_measure_at_5_deg")
    np.testing.assert_array_equal(f_measure[~filled], 1.0)
    assert 0 < f_measure[filled].min() <= f_measure[filled].max() < 0.5  # of a volume so many balls cover little
    (scores,) = truth["objects"].values()
    headline = scores["hypotheses"]["headline"]
    assert headline["value"] == pytest.approx(headline["best_possible"], abs=0.05)


def test_hypotheses_that_are_spread_over_a_volume_have_less_error_than_one_or_than_random_ones(rows, filled):
    errors = {
        name: column(rows[name], "hypotheses", "recall_mean_error_image_mean_rad")[filled].mean()
        for name in ("truth", "evenly-placed", "one-true-rotation", "uniform")
    }
    assert errors["truth"] < 0.5 * errors["evenly-placed"]
    assert errors["evenly-placed"] < 0.9 * errors["uniform"]
    assert errors["evenly-placed"] < 0.5 * errors["one-true-rotation"]
    for name in ("evenly-placed", "one-true-rotation"):
        np.testing.assert_array_equal(column(rows[name], "hypotheses", "accuracy_at_5_deg"), 1.0)
    assert value(rows["uniform"], "hypotheses", "accuracy_at_5_deg") < 0.6


def test_who_is_blind_to_the_parts_of_a_ball_answers_with_all_rotations(rows, dataset, filled):
    volume_measure = dataset.labels().volumes[0].measure
    blind = rows["body-group"]
    accuracy = column(blind, "hypotheses", "accuracy_at_5_deg")
    assert accuracy[~filled].max() < 0.02
    np.testing.assert_allclose(accuracy[filled], volume_measure, atol=0.1)
    assert value(blind, "density", "log_likelihood") == pytest.approx(-2 * np.log(np.pi))
    (scores,) = blind["objects"].values()
    assert scores["hypotheses"]["M"] == IN_VOLUME
    assert "classifier" not in scores


def test_a_classifier_that_says_yes_to_queries_does_not_rank_on_a_ball_either(rows):
    (scores,) = rows["yes-to-queries"]["objects"].values()
    assert any("depend on being asked" in warning for warning in scores["classifier"]["warnings"])
    assert value(rows["yes-to-queries"], "classifier", "decoy_false_positive_rate") == 1.0


def test_the_truth_rounded_to_the_grid_has_its_volume_right(rows, filled):
    recall, precision = (column(rows["rounded-to-grid"], "classifier", name) for name in ("recall", "precision"))
    np.testing.assert_array_equal(recall, 1.0)
    assert precision[filled].min() > 0.7 > precision[~filled].max()


def test_a_file_and_what_is_in_memory_have_the_same_scores(dataset, tmp_path):
    rng = np.random.default_rng(0)
    hypotheses = uniform_rotations(IMAGES * 6, rng).reshape(IMAGES, 6, 3, 3)
    answers = {
        "hypotheses": hypotheses,
        "classifier": lambda i, R: 1 / (1 + np.exp(-8 * R[:, 0, 0] - i / IMAGES)),
        "density": lambda i, R: 3 * R[:, 1, 1],
    }
    path = tmp_path / "answers.h5"
    write_hypotheses(path, dataset, hypotheses, method="any")
    write_classifier(path, dataset, answers["classifier"], method="any", level=LEVEL)
    write_density(path, dataset, answers["density"], method="any", level=LEVEL)
    of_file, held = score_file(path, dataset.folder), score(answers, dataset, level=LEVEL)
    for track in answers:
        for metric, values in of_file.tracks[track].per_image.values.items():
            np.testing.assert_array_equal(values, held.per_image[track][metric], f"{track} {metric}")


def test_queries_are_the_candidates_among_decoys_of_their_form(dataset, tmp_path):
    write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    labels = dataset.labels()
    queries = Queries(dataset.fingerprint, labels.symmetry_group)
    with h5py.File(tmp_path / "queries.h5") as file:
        asked = file["query_rotation"][3]
    in_order = np.empty_like(asked)
    in_order[np.argsort(queries.unshuffle(3, np.arange(len(queries))).ravel())] = asked
    assert len(asked) == 9 * len(labels.symmetry_group)
    inverse = np.empty((len(asked), 3, 3))
    for place, number in enumerate(queries.shuffle(3, np.arange(len(queries)).reshape(9, -1))):
        inverse[number] = asked[place]
    np.testing.assert_allclose(inverse[: len(labels.symmetry_group)], labels.candidates(3), atol=1e-6)
    decoys = inverse[len(labels.symmetry_group) :].reshape(8, -1, 3, 3)
    np.testing.assert_allclose(decoys, queries.decoys(3), atol=1e-6)
    np.testing.assert_allclose(decoys, decoys[:, :1] @ labels.symmetry_group, atol=1e-6)


def test_answers_to_the_queries_of_another_list_of_candidates_are_refused_in_one_line(dataset, tmp_path):
    path = tmp_path / "answers.h5"
    write_classifier(path, dataset, lambda _, R: np.full(len(R), 0.5), method="any", level=LEVEL)
    with h5py.File(path, "r+") as file:
        file.attrs["group_sha256"] = "0" * 64
    with pytest.raises(PredictionsError, match=r"group_sha256.*expected .* found '0{64}'") as caught:
        score_file(path, dataset.folder)
    assert len(caught.value.faults) == 1


def test_sizes_in_scores_files_count_the_standard_grid_inside_volumes(rows, dataset, filled):
    (scores,) = rows["truth"]["objects"].values()
    sizes, truth = np.array(scores["per_image"]["set_size"]), truth_of(dataset)
    np.testing.assert_array_equal(sizes, truth.set_sizes)
    (volume,) = truth.labels.volumes
    np.testing.assert_allclose(sizes[filled], 294_912 * volume.measure, rtol=0.01)
    assert sizes[~filled].max() <= len(truth.symmetry_group)
