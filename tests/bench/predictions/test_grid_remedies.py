"""Answers on the grid in another form are refused with a line of code, and the line mends them."""

import numpy as np
import pytest
import torch
from remedy_lines import IMAGES, LEVEL, line_of

from symsol_annot.bench.predictions.advice.answer_remedies import fault_of_log_densities, is_normalised
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import angle_between

CELLS = 576


@pytest.fixture(scope="module")
def members(dozen):
    labels = dozen.labels()
    return [labels.symmetry_set(i) for i in range(IMAGES)]


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
def test_the_line_for_a_classifier_mends_it(dozen, members, tmp_path, given):
    classify = given(logits(members))
    with pytest.raises(SettingsError, match="image 0: ") as refused:
        write_classifier(tmp_path / "preds.h5", dozen, classify, method="mine", level=LEVEL)
    names = {"classify": classify}
    exec(line_of(refused), names)
    write_classifier(tmp_path / "preds.h5", dozen, names["classify"], method="mine", level=LEVEL)
    figures = score_file(tmp_path / "preds.h5", dozen.folder).tracks["classifier"].figures["all"]
    assert figures["recall"].value == 1.0


@pytest.mark.parametrize("batch_size", [100, 10**6])
def test_a_classifier_that_is_normalised_over_what_it_is_asked_is_a_density(dozen, members, tmp_path, batch_size):
    def softmax(i, R):
        p = np.exp(0.2 * logits(members)(i, R))
        return p / p.sum()

    with pytest.raises(SettingsError, match="image 0: the answers add up to 1 over the rotations asked") as refused:
        write_classifier(tmp_path / "no.h5", dozen, softmax, method="mine", level=LEVEL, batch_size=batch_size)
    path = tmp_path / "preds.h5"
    exec(line_of(refused), {"path": path, "dataset": dozen, "classify": softmax, "method": "mine"})
    figures = score_file(path, dozen.folder).tracks["density"].figures["all"]
    assert figures["log_likelihood"].value > 1.0


@pytest.mark.parametrize("answers", [np.eye(108)[3], np.zeros(108), np.full(108, 0.5), np.eye(108)[3] + np.eye(108)[9]])
def test_one_certain_answer_is_not_taken_for_a_softmax(answers):
    assert not is_normalised(answers, 50)
    assert not is_normalised(answers, 108)


def test_an_array_in_place_of_a_classifier_is_refused(dozen, tmp_path):
    with pytest.raises(SettingsError, match=r"classify: expected a callable, found ndarray; .* go to write_columns"):
        write_classifier(tmp_path / "preds.h5", dozen, np.zeros((IMAGES, CELLS)), method="mine", level=LEVEL)


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
def test_the_line_for_a_density_mends_it(dozen, members, tmp_path, form):
    given = DENSITIES[form](log_density(members))
    with pytest.raises(SettingsError, match="image 0: ") as refused:
        write_density(tmp_path / "preds.h5", dozen, given, method="mine", level=LEVEL)
    names = {"log_density": given}
    exec(line_of(refused), names)
    write_density(tmp_path / "preds.h5", dozen, names["log_density"], method="mine", level=LEVEL)
    assert likelihood(tmp_path / "preds.h5", dozen) > 0.5


def likelihood(path, dataset):
    return score_file(path, dataset.folder).tracks["density"].figures["all"]["log_likelihood"].value


@pytest.mark.parametrize("volume", [1.0, np.pi**2, 8 * np.pi**2])
def test_a_density_over_the_volume_of_so3_is_told_from_logarithms(members, volume):
    log_p = normalised(-60.0 * angle_between(equivolumetric_grid(LEVEL), members[0][0]))
    values = np.exp(log_p) * CELLS / volume
    assert "these look like probabilities" in fault_of_log_densities(values, BATCH, LEVEL)


@pytest.mark.parametrize("given", [lambda log_p: log_p, np.exp], ids=["logarithms", "probabilities"])
def test_what_is_normalised_in_each_batch_is_asked_about_the_whole_grid(dozen, members, tmp_path, given):
    """Its constants differ from batch to batch, so that batches cannot be compared."""
    path, whole = tmp_path / "preds.h5", log_density(members)

    def of_batch(i, R):
        return given(normalised(whole(i, R)))

    with pytest.raises(SettingsError, match=r"image 0: .* add up to 1 in each batch") as refused:
        write_density(tmp_path / "no.h5", dozen, of_batch, method="mine", level=LEVEL, batch_size=BATCH)
    exec(line_of(refused), {"path": path, "dataset": dozen, "log_density": of_batch, "method": "mine"})
    write_density(tmp_path / "right.h5", dozen, whole, method="mine", level=LEVEL)
    assert likelihood(path, dozen) == pytest.approx(likelihood(tmp_path / "right.h5", dozen), abs=0.01)


def test_an_array_in_place_of_a_density_is_mended(dozen, members, tmp_path):
    given = np.stack([log_density(members)(i, equivolumetric_grid(LEVEL)) for i in range(IMAGES)])
    with pytest.raises(SettingsError, match="log_density: expected a callable, found ndarray") as refused:
        write_density(tmp_path / "no.h5", dozen, given, method="mine", level=LEVEL)
    path = tmp_path / "preds.h5"
    exec(line_of(refused), {"path": path, "dataset": dozen, "log_density": given, "method": "mine"})
    assert likelihood(path, dozen) > 0.5


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
