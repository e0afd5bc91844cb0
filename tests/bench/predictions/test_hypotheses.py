"""Reading the track of hypotheses: rotations and their weights."""

import numpy as np
import pytest
from changed_predictions import MISSING, SHAPE, changed, figures, replaced
from valid_predictions import HYPOTHESES, IMAGES

from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED


def test_hypotheses_of_weight_0_may_be_anything(scores, valid):
    absent = np.zeros((IMAGES, HYPOTHESES))
    absent[:, 0] = 1.0
    hypotheses = changed(valid[0]["hypotheses"], np.s_[:, 1:], np.nan)
    first = scores({"hypotheses": valid[0]["hypotheses"][:, :1], "hypothesis_weights": MISSING})
    found, expected = figures(scores({"hypotheses": hypotheses, "hypothesis_weights": absent})), figures(first)
    shared = {key for key in expected if key[0] == "hypotheses"}
    assert {key for key in found if key[0] == "hypotheses"} - shared == {("hypotheses", F_UNWEIGHTED)}
    assert {key: found[key] for key in shared} == pytest.approx({key: expected[key] for key in shared})


@pytest.mark.parametrize("factor", [5e-324, 1e-310, 1e300, 1e308])
def test_a_score_does_not_depend_on_the_size_of_the_weights(scores, valid, factor):
    """Angles times denormal weights would vanish, and sums of the largest be infinite."""
    weights = np.array(valid[0]["hypothesis_weights"] > 0, dtype=np.float64)
    expected = figures(scores({"hypothesis_weights": weights}))
    assert figures(scores({"hypothesis_weights": weights * factor})) == pytest.approx(expected, nan_ok=True)


NUMBERS = ("f2", "g", "i4", "i8", "u1", ">i2")


@pytest.mark.parametrize("dtype", NUMBERS)
def test_hypotheses_of_another_type_are_named_with_it(faults, dtype):
    found = faults(edit=replaced("hypotheses", shape=SHAPE, dtype=dtype))
    size = np.dtype(dtype).str[1:]
    shape = f"({IMAGES}, M, 3, 3), found {size} of shape ({IMAGES}, {HYPOTHESES}, 3, 3)"
    assert found.startswith(f"hypotheses: 'hypotheses': expected f4 or f8 of shape {shape}; ")


SHAPES = {
    "a matrix an image": (IMAGES, 3, 3),
    "nine numbers": (IMAGES, 9),
    "nine numbers a hypothesis": (IMAGES, HYPOTHESES, 9),
    "an axis more": (1, *SHAPE),
    "an image less": (IMAGES - 1, *SHAPE[1:]),
    "an image more": (IMAGES + 1, *SHAPE[1:]),
    "no image": (0, *SHAPE[1:]),
    "one number": (),
    "4 by 4": (IMAGES, HYPOTHESES, 4, 4),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_hypotheses_of_another_shape_are_named_with_it(faults, kind):
    found = faults(edit=replaced("hypotheses", shape=SHAPES[kind], dtype="f8"))
    assert f"expected f4 or f8 of shape ({IMAGES}, M, 3, 3), found f8 of shape {SHAPES[kind]}" in found
    assert ("4x4 poses" in found) == (kind == "4 by 4")


@pytest.mark.parametrize("shape", [(IMAGES, 4), (IMAGES, HYPOTHESES, 4)])
def test_quaternions_in_place_of_matrices_are_called_so(faults, shape):
    found = faults(edit=replaced("hypotheses", shape=shape, dtype="f8"))
    assert "; these look like quaternions: " in found


@pytest.mark.parametrize(("count", "dtype"), [(0, "f8"), (10_001, "f4")])
def test_too_few_or_too_many_hypotheses_are_counted(faults, count, dtype):
    stored = {"shape": (IMAGES, count, 3, 3), "dtype": dtype}
    found = faults({"hypothesis_weights": MISSING}, edit=replaced("hypotheses", **stored))
    assert found == f"hypotheses: M = {count}: 1 to 10000 hypotheses per image are read"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_hypotheses_that_are_not_finite_are_named_by_row(faults, valid, value):
    hypotheses = changed(valid[0]["hypotheses"], ([1, 4], [2, 0], 0, 1), value)
    assert faults({"hypotheses": hypotheses}) == "hypotheses: 'hypotheses' has a NaN or an infinite entry: rows 1, 4"


NO_ROTATIONS = {
    "a reflection": (np.diag([1.0, 1.0, -1.0]), "off by 2, with determinant -1"),
    "a stretched one": (np.diag([1.01, 1.0, 1.0]), "off by 0.02"),
    "a singular one": (np.zeros((3, 3)), "off by 1"),
    "a sheared one": (np.eye(3) + 0.3 * np.eye(3, k=1), "off by 0.3"),
    "a huge one": (np.full((3, 3), 1e200), "off by inf"),
    "a tiny one": (5e-318 * np.array([[0, 1, 1], [1, 2, 3], [1, 3, 2]]), "off by 1"),
    "one whose determinant is NaN": (1.7e308 * np.array([[0, 0, 1], [-1, 1, 1], [1, -1, 1]]), "off by inf"),
}


@pytest.mark.parametrize("kind", NO_ROTATIONS)
def test_matrices_that_are_no_rotations_are_named_by_row_and_by_how_far_off_they_are(faults, valid, kind):
    matrix, off = NO_ROTATIONS[kind]
    found = faults({"hypotheses": changed(valid[0]["hypotheses"], (3, 1), matrix)})
    rule = "(R^T R = I and det R = 1 within 0.0001)"
    mend = "; project what was rounded: U, _, Vt = np.linalg.svd(R.astype(np.float64)); R = U @ Vt"
    rule += mend if kind == "a stretched one" else ""
    assert found == f"hypotheses: 'hypotheses' holds a matrix that is no rotation {rule}: row 3 (hypothesis 1, {off})"


@pytest.mark.parametrize(("dtype", "tolerance"), [("f4", 1e-4), ("f8", 1e-4)])
def test_a_rotation_may_be_as_far_off_as_its_type_allows(scores, faults, valid, dtype, tolerance):
    def off_by(amount):
        stretched = valid[0]["hypotheses"] * (1 + amount / 3)  # det R is then off by the amount
        return {"hypotheses": stretched.astype(dtype)}

    scores(off_by(0.9 * tolerance))
    assert f"within {tolerance:g}); project what was rounded: " in faults(off_by(1.1 * tolerance))


def test_transposes_of_rotations_are_rotations_and_score_worse(scores, valid):
    right = scores(tracks=["hypotheses"])
    wrong = scores({"hypotheses": np.swapaxes(valid[0]["hypotheses"], 2, 3)}, tracks=["hypotheses"])
    key = ("hypotheses", "precision_mean_error_rad")
    assert figures(right)[key] < 1e-6 < figures(wrong)[key]


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        ((2, 1), -0.1, "are not all finite and at least 0: row 2"),
        ((2, 1), np.nan, "are not all finite and at least 0: row 2"),
        ((5, 0), np.inf, "are not all finite and at least 0: row 5"),
        ((2,), 0.0, "has no positive one: row 2"),
    ],
)
def test_weights_that_weigh_nothing_are_named_by_row(faults, valid, at, value, reason):
    weights = changed(valid[0]["hypothesis_weights"], at, value)
    assert faults({"hypothesis_weights": weights}) == f"hypotheses: 'hypothesis_weights' {reason}"


def test_weights_of_another_shape_are_named_with_it(faults, valid):
    found = faults({"hypothesis_weights": valid[0]["hypothesis_weights"][:, :2]})
    assert found.endswith("expected f4 or f8 of shape (6, 3), found f8 of shape (6, 2)")
    assert faults({"hypotheses": MISSING}) == "hypotheses: data set 'hypotheses' is missing"
