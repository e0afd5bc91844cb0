"""What a caller or its callable answers: how it is stored, and what is no answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from written_predictions import (
    CELLS,
    IMAGES,
    LEVEL,
    METHOD,
    Interrupted,
    contents,
    hypothesise,
    log_density,
    rows_of,
    write,
)

from symsol_annot.bench.predictions.writing.submission import write_density
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.rotations.grid import GridIndex, equivolumetric_grid

EDGES = [  # an answer, and whether it is above the floor of 0.1
    (lambda R: np.zeros(len(R), dtype=np.float16), False),
    (lambda R: np.full(len(R), np.float32(0.1)), False),  # as the floor is; in float32 that is more than 0.1
    (lambda R: np.nextafter(np.full(len(R), np.float32(0.1)), np.float32(1)), True),
    (lambda R: [1] * len(R), True),
    (lambda R: R[:, 0, 0] < 2, True),  # yes or no
    (lambda R: np.full(len(R), 1.0 + 1e-12), True),  # which float32 rounds to 1
]


def test_answers_at_the_edges_are_answers(tetX, tmp_path):
    write("classifier", tmp_path / "preds.h5", tetX, lambda i, R: EDGES[i % len(EDGES)][0](R))
    listed = [CELLS * EDGES[i % len(EDGES)][1] for i in range(IMAGES)]
    assert np.array_equal(np.diff(contents(tmp_path / "preds.h5")[0]["grid_offsets"]), listed)


def densities(path):
    columns, _ = contents(path)
    bounds = columns["density_offsets"]
    return rows_of(columns["density_indices"], bounds), rows_of(columns["density_log_probabilities"], bounds)


def softmax(log_p):
    p = np.exp(log_p - log_p.max())
    return p / p.sum()


def test_a_density_is_made_to_add_up_to_1_and_unlisted_cells_keep_their_mass(tetX, tmp_path):
    floor = 0.01
    write("density", tmp_path / "preds.h5", tetX, floor=floor, batch_size=50)
    for i, (listed, log_p) in enumerate(zip(*densities(tmp_path / "preds.h5"), strict=True)):
        p = softmax(log_density(i, equivolumetric_grid(LEVEL)))
        assert 0 < len(listed) < CELLS
        assert np.array_equal(listed, np.flatnonzero(p > floor))
        assert np.allclose(np.exp(log_p), p[listed], rtol=1e-12, atol=0)
        assert 1.0 - np.exp(log_p).sum() == pytest.approx(p[p <= floor].sum(), abs=1e-12)


def test_a_density_is_listed_whole_and_adds_up_to_1(tetX, tmp_path):
    write("density", tmp_path / "preds.h5", tetX)
    for listed, log_p in zip(*densities(tmp_path / "preds.h5"), strict=True):
        assert len(listed) == CELLS
        assert np.exp(log_p).sum() == pytest.approx(1.0, abs=1e-5)  # which the format allows


def test_a_density_that_is_certain_gives_the_floor_to_every_other_cell(tetX, tmp_path):
    certain = [
        lambda i, cell: np.where(cell == i, 0.0, -np.inf),
        lambda i, cell: np.where(cell == i, 1e300, 0.0),
        lambda i, cell: np.where(cell < 2 + i, 0.0, -40.0),
    ]
    write("density", tmp_path / "preds.h5", tetX, lambda i, R: certain[i % 3](i, np.arange(len(R))))
    for i, (listed, log_p) in enumerate(zip(*densities(tmp_path / "preds.h5"), strict=True)):
        assert len(listed) == CELLS
        assert np.exp(log_p[: i + 1]).sum() > 0.0
        assert log_p.min() == pytest.approx(np.log(1e-300) if i % 3 < 2 else np.log(np.exp(-40) / (2 + i)), abs=0.01)


@given(
    seed=st.integers(0, 2**32), constant=st.floats(-1e6, 1e6), exponent=st.floats(-8, 3), floor=st.floats(-300, -0.01)
)
@settings(deadline=None, max_examples=100)
def test_what_a_density_file_says_of_a_cell_is_the_densitys_own_or_at_most_the_floor(seed, constant, exponent, floor):
    from symsol_annot.bench.predictions.writing.given_answers import listed_density

    log_p = constant + 10.0**exponent * np.random.default_rng(seed).normal(size=500)
    log_p = log_p - np.logaddexp.reduce(log_p)
    rows = listed_density(log_p, 10.0**floor)
    mass = np.exp(rows["density_log_probabilities"]).sum()
    if len(rows["density_indices"]) < 500:
        assert mass < 1.0
        rest = (1.0 - mass) / (500 - len(rows["density_indices"]))  # as docs/submission.md shares it
    else:
        assert mass == pytest.approx(1.0, abs=1e-5)
        rest = np.nan
    in_file = np.full(500, np.log(rest))
    in_file[rows["density_indices"]] = rows["density_log_probabilities"]
    is_above = log_p > floor * np.log(10.0)
    assert np.allclose(in_file[is_above], log_p[is_above], rtol=0, atol=0.01)
    assert (in_file[~is_above] <= floor * np.log(10.0) + 0.01).all()
    if exponent < 0:  # nothing is below the default floor
        assert np.allclose(listed_density(log_p, 1e-300)["density_log_probabilities"], log_p, rtol=0, atol=0.01)


def one_mode(labels, kappa):
    """A Bingham-like density around the first member of each set alone: it misses the others."""
    return lambda i, R: kappa * (np.einsum("nij,ij->n", R, labels.symmetry_set(i)[0]) - 3.0)


@pytest.mark.parametrize("kappa", [0.5, 8.0, 80.0])
def test_log_likelihood_of_a_file_is_the_densitys_own(tetX, tmp_path, kappa):
    level, labels = 2, tetX.labels()
    log_density = one_mode(labels, kappa)
    write_density(tmp_path / "preds.h5", tetX, log_density, method=METHOD, level=level)
    grid, own = GridIndex(level), []
    for i in range(IMAGES):
        log_p = log_density(i, grid.rotations)
        log_p = log_p - np.logaddexp.reduce(log_p)
        own.append(log_p[grid.nearest(labels.symmetry_set(i))].mean() + np.log(len(grid) / np.pi**2))
    scored = score_file(tmp_path / "preds.h5", tetX.folder).tracks["density"].figures["all"]["log_likelihood"].value
    assert scored == pytest.approx(np.mean(own), abs=0.01)


NOT_HYPOTHESES = [
    (np.eye(3), SettingsError, r"expected float32 or float64 of shape \(m, 3, 3\).*found float64 of shape \(3, 3\)"),
    (np.zeros((0, 3, 3)), SettingsError, r"found float64 of shape \(0, 3, 3\)"),
    (np.zeros((10_001, 3, 3)), SettingsError, r"m from 1 to 10000, found float64 of shape \(10001, 3, 3\)"),
    (np.eye(3, dtype=int)[None], SettingsError, "found int64"),
    (np.eye(3, dtype=np.float16)[None], SettingsError, "found float16"),
    (None, SettingsError, "found object"),
    ([[1.0], [1.0, 2.0]], SettingsError, "expected an array of numbers"),
    (np.zeros((2, 4, 4)), RotationError, r"found \(2, 4, 4\)"),
    (np.tile([1.0, 0, 0, 0], (5, 1, 1)), RotationError, r"found \(5, 1, 4\)"),
    (np.full((1, 3, 3), np.nan), RotationError, "off by nan"),
    (-np.eye(3)[None], RotationError, "off by 2"),
    (np.stack([np.eye(3), 1.01 * np.eye(3)]), RotationError, r"1 of 2 matrices .* in row 1: .*\(allowed 0.0001\)"),
]


@pytest.mark.parametrize(("answer", "error", "words"), NOT_HYPOTHESES)
def test_what_is_no_hypotheses_is_refused_with_its_image_and_may_be_mended(tetX, tmp_path, answer, error, words):
    with pytest.raises(error, match=f"(?s)hypotheses of image 7.*{words}"):
        write("hypotheses", tmp_path / "preds.h5", tetX, lambda i: answer if i == 7 else hypothesise(i))
    left = Interrupted("hypotheses", 8)
    with pytest.raises(RuntimeError):
        write("hypotheses", tmp_path / "preds.h5", tetX, left, resume=True)
    assert left.asked == [7]


def replaced(cell, value):
    """An answer about image 7 that is wrong at one rotation."""
    return lambda R: np.where(np.arange(len(R)) == cell, value, 0.5)


NOT_ANSWERS = [
    (lambda R: np.zeros((len(R), 1)), r"asked about \d+ rotations, the answer has the shape \(\d+, 1\)"),
    (lambda R: np.zeros(len(R) - 1), "the answer has the shape"),
    (lambda R: 0.5, r"the answer has the shape \(\)"),
    (lambda R: None, "expected an array of numbers, found object"),
    (lambda R: ["a"] * len(R), "expected an array of numbers, found <U1"),
    (lambda R: np.zeros(len(R), dtype=complex), "found complex128"),
    (replaced(3, np.nan), "found nan"),
    (replaced(3, np.inf), "found inf"),
]


NOT_PROBABILITIES = [
    (replaced(0, 1.001), r"expected probabilities from 0 to 1, found 1\.001"),
    (replaced(70, -0.001), r"expected probabilities from 0 to 1, found -0\.001"),
    (replaced(3, -np.inf), "found -inf"),
]


NOT_LOG_DENSITIES = [(lambda R: np.full(len(R), -np.inf), "at least one of them finite, found -inf")]


@pytest.mark.parametrize(
    ("track", "answer", "words"),
    [("classifier", *case) for case in NOT_ANSWERS + NOT_PROBABILITIES]
    + [("density", *case) for case in NOT_ANSWERS + NOT_LOG_DENSITIES],
)
def test_what_is_no_answer_is_refused_with_its_image(tetX, tmp_path, track, answer, words):
    with pytest.raises(SettingsError, match=f"image 7: .*{words}"):
        write(track, tmp_path / "preds.h5", tetX, lambda i, R: answer(R) if i == 7 else np.full(len(R), 0.5))
    assert not (tmp_path / "preds.h5").exists()
