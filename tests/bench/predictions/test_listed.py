"""What models list by themselves is what they would have been asked for, rotation by rotation."""

import numpy as np
import pytest
from written_predictions import LEVEL, METHOD, contents, log_density, probability, write

from symsol_annot.bench.predictions.tracks.classifier import DEFAULT_FLOOR
from symsol_annot.bench.predictions.writing.listed import write_cells, write_claims
from symsol_annot.errors import PredictionsError
from symsol_annot.rotations.grid import equivolumetric_grid


def claims_on_grid(i):
    """Every grid rotation but for some under the floor."""
    probabilities = probability(i, equivolumetric_grid(LEVEL))
    listed = np.flatnonzero(probabilities > DEFAULT_FLOOR / 2)
    return listed, probabilities[listed]


def on_cells(i):
    return log_density(i, equivolumetric_grid(LEVEL)) + 7.0  # up to a constant


@pytest.mark.parametrize("floor", [1e-300, 0.01])
def test_cells_are_those_of_the_density_that_is_asked(tetX, tmp_path, floor):
    write_cells(tmp_path / "listed.h5", tetX, on_cells, method=METHOD, floor=floor, level=LEVEL, resume="me")
    write("density", tmp_path / "asked.h5", tetX, floor=floor)
    (listed, attributes), (asked, expected) = (contents(tmp_path / f"{name}.h5") for name in ("listed", "asked"))
    assert attributes == expected
    assert np.array_equal(listed["density_indices"], asked["density_indices"])
    values = "density_log_probabilities"
    np.testing.assert_allclose(listed.pop(values), asked.pop(values), atol=1e-12)


def test_claims_are_those_of_the_classifier_that_is_asked(tetX, tmp_path):
    write_claims(tmp_path / "listed.h5", tetX, probability, claims_on_grid, method=METHOD, level=LEVEL, resume="me")
    write("classifier", tmp_path / "asked.h5", tetX)
    assert (tmp_path / "listed.h5").read_bytes() == (tmp_path / "asked.h5").read_bytes()


def test_what_is_put_around_the_answers_is_asked_for_each_image(tetX, tmp_path):
    asked = []

    def around(answer):
        def ask(i):
            asked.append(i)
            return answer(i)

        return ask

    settings = {"method": METHOD, "level": LEVEL, "resume": "me", "around": around}
    write_cells(tmp_path / "preds.h5", tetX, on_cells, floor=0.01, **settings)
    write_claims(tmp_path / "preds.h5", tetX, probability, claims_on_grid, **settings)
    assert asked == [*range(len(tetX)), *range(len(tetX))]


def test_wrong_answers_are_faults_of_the_file(tetX, tmp_path):
    def descending(i):
        listed, probabilities = claims_on_grid(i)
        return listed[::-1], probabilities[::-1]

    with pytest.raises(PredictionsError, match="not ascending"):
        write_claims(tmp_path / "preds.h5", tetX, probability, descending, method=METHOD, level=LEVEL, resume="me")
    assert not (tmp_path / "preds.h5").exists()
