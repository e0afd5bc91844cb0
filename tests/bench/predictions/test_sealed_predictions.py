"""Predictions about a sealed set: written and validated by anybody, scored by whoever has the secret."""

import shutil

import h5py
import numpy as np
import pytest
from sealed_tests import IMAGES, NAME, found_by_metadata, sealed_test
from tampering import put, tampered

from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.scoring.scoring import score, score_file
from symsol_annot.bench.submission import write_classifier, write_columns, write_density, write_hypotheses
from symsol_annot.errors import PredictionsError, SealError
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load
from symsol_annot.sets.plan import label_rotation


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return sealed_test(tmp_path_factory.mktemp("sealed") / "tetX")


def random_hypotheses(count=4):
    return uniform_rotations(IMAGES * count, np.random.default_rng(0)).reshape(IMAGES, count, 3, 3)


@pytest.fixture(scope="module")
def preds(made, tmp_path_factory):
    """A file with the two tracks that are offered, from images alone."""
    path, images = tmp_path_factory.mktemp("preds") / "preds.h5", load(made / "public")
    write_hypotheses(path, images, random_hypotheses(), method="mine")
    write_density(path, images, lambda i, R: images[i].image.mean() * R[:, 0, 0], method="mine", level=1)
    return path


def figures(path, data, secrets=()):
    with open_predictions(path, data, secrets) as predictions:
        scores = score(predictions)
    return {track: made.figures for track, made in scores.tracks.items()}


def test_predictions_are_validated_without_the_secret(made, preds):
    with open_predictions(preds, made / "public") as predictions:
        predictions.check()
        assert [reader.name for reader in predictions.readers] == ["hypotheses", "density"]
        assert len(predictions.about) == IMAGES


def test_they_are_not_scored_without_it_and_the_refusal_is_one_line(made, preds):
    with pytest.raises(SealError, match="is sealed, so predictions about it are scored by whoever") as refused:
        score_file(preds, made / "public")
    assert "\n" not in str(refused.value)


def test_with_the_secret_they_score_as_the_same_answers_do_on_the_set_with_labels(made, preds, tmp_path):
    path, labelled = tmp_path / "preds.h5", load(made / "labelled")
    write_hypotheses(path, labelled, random_hypotheses(), method="mine")
    write_density(path, labelled, lambda i, R: labelled[i].image.mean() * R[:, 0, 0], method="mine", level=1)
    expected = figures(path, made / "labelled")
    found = figures(preds, made / "public", [made / "secret.json"])
    assert repr(found) == repr(expected)  # NaN is itself there


def test_the_truth_scores_1_and_metadata_score_as_a_blind_method_does(made, tmp_path):
    """A method that reads all but the pixels, and is even told the first image's rotation, stays at chance."""
    images, labelled = load(made / "public"), load(made / "labelled")
    seeds = {
        "metadata": found_by_metadata(made / "public", labelled[0].rotation),
        "blind": None,
        "who holds the labels": found_by_metadata(made / "labelled", labelled[0].rotation),
    }
    coverage = {}
    for method, seed in seeds.items():
        blind = random_hypotheses(3)
        R = blind if seed is None else np.stack([label_rotation(seed, NAME, "test", i)[None] for i in range(IMAGES)])
        path = tmp_path / f"{method}.h5"
        write_hypotheses(path, images, R, method=method)
        found = figures(path, made / "public", [made / "secret.json"])["hypotheses"]["all"]
        coverage[method] = found["accuracy_at_5_deg"].value
    assert coverage["who holds the labels"] == 1.0
    assert coverage["metadata"] == coverage["blind"] < 0.05


# What is refused


def test_the_classifier_is_not_asked_of_sealed_images(made, preds, tmp_path):
    images = load(made / "public")
    with pytest.raises(SealError, match="'classifier' is not offered on sealed images: an image's queries hold"):
        write_classifier(tmp_path / "preds.h5", images, lambda i, R: np.ones(len(R)), method="mine")
    columns = {"query_probability": np.zeros((IMAGES, 108))}
    with pytest.raises(SealError, match="'classifier' is not offered"):
        write_columns(tmp_path / "preds.h5", images, "classifier", columns, method="mine")
    assert list(tmp_path.iterdir()) == []


def test_a_file_with_that_track_is_refused_with_and_without_the_secret(made, preds, tmp_path):
    path = shutil.copy(preds, tmp_path)
    with h5py.File(path, "r+") as file:
        file["query_probability"] = np.zeros((IMAGES, 108))
    for secrets in ((), [made / "secret.json"]):
        refused = pytest.raises(PredictionsError, match="'classifier' is not offered on sealed images")
        with open_predictions(path, made / "public", secrets) as predictions, refused:
            predictions.check()


def test_another_tests_secret_is_named_with_both_digests(made, preds, tmp_path):
    other = sealed_test(tmp_path / "other", images=2)
    with pytest.raises(SealError, match=r"is sealed with a secret of digest \w{16}, and .* has \w{16}: it is another"):
        score_with(preds, made, other / "secret.json")
    assert figures(preds, made / "public", [other / "secret.json", made / "secret.json"])


def score_with(preds, made, *secrets):
    return figures(preds, made / "public", list(secrets))


def test_a_secret_whose_labels_are_not_there_is_told_what_makes_them(made, preds, tmp_path):
    shutil.copy(made / "secret.json", tmp_path)
    with pytest.raises(SealError, match=r"holds no labels yet; `symsol-annot seal render"):
        score_with(preds, made, tmp_path / "secret.json")


def test_labels_of_other_images_are_refused(made, preds, tmp_path):
    """Other software may draw another pixel: then nobody knows that the labels are these images'."""
    folder = shutil.copytree(made, tmp_path / "tetX")
    with tampered(folder / "labelled", "test-00001-of-00002.h5") as file:
        image = file["image"][...]
        image[0, 0, 0] ^= 1
        put(file, "image", image)
    with pytest.raises(SealError, match="its images are not those of"):
        score_with(preds, made, folder / "secret.json")


def test_labels_of_another_test_beside_a_secret_are_refused(made, preds, tmp_path):
    folder = tmp_path / "tetX"
    shutil.copytree(sealed_test(tmp_path / "other"), folder)
    shutil.copy(made / "secret.json", folder)
    with pytest.raises(SealError, match=r"labelled: is not the set that .* seals; it differs in seed"):
        score_with(preds, made, folder / "secret.json")


def test_predictions_of_the_set_with_labels_are_not_taken_for_the_sealed_images(made, tmp_path):
    path = tmp_path / "preds.h5"
    write_hypotheses(path, load(made / "labelled"), random_hypotheses(), method="mine")
    refused = pytest.raises(PredictionsError, match="attribute 'fingerprint'")
    with open_predictions(path, made / "public", [made / "secret.json"]) as predictions, refused:
        predictions.check()
