"""Reading the track of a classifier: probabilities at the queries and on the grid."""

import numpy as np
import pytest
from changed_predictions import changed, figures
from valid_predictions import LEVEL


def test_a_floor_may_be_a_long_double_or_a_whole_number(scores):
    for floor, stored in ((1 / 16, np.longdouble(1) / 16), (0.0, 0)):
        expected = figures(scores(attributes={"floor": floor}))
        assert figures(scores(attributes={"floor": stored})) == pytest.approx(expected, nan_ok=True)
    scored = scores(attributes={"method": np.bytes_(b"in bytes"), "grid_level": np.uint8(LEVEL)})
    assert scored.method == "in bytes"


@pytest.mark.parametrize("value", [-1e-9, 1.0001, np.nan, np.inf, -np.inf])
def test_probabilities_outside_0_to_1_are_named_by_row(faults, valid, value):
    asked = changed(valid[0]["query_probability"].astype(np.float64), (4, 7), value)
    mend = "; write np.clip(p, 0, 1)" if np.isfinite(value) else ""
    assert faults({"query_probability": asked}) == f"classifier: 'query_probability' is not in [0, 1]{mend}: row 4"
    row = int(np.flatnonzero(np.diff(valid[0]["grid_offsets"]))[1])
    at = valid[0]["grid_offsets"][row]
    found = faults({"grid_probabilities": changed(valid[0]["grid_probabilities"], at, value)})
    assert found == f"classifier: 'grid_probabilities' are not above the floor 0.1 and at most 1: row {row}"


def test_a_listed_probability_at_the_floor_is_a_fault(faults, valid):
    column = changed(valid[0]["grid_probabilities"].astype(np.float64), 0, 0.1)
    assert "'grid_probabilities' are not above the floor 0.1 and at most 1" in faults({"grid_probabilities": column})


def test_another_number_of_queries_is_named_with_what_belongs_there(faults, valid):
    found = faults({"query_probability": valid[0]["query_probability"][:, :12]})
    assert found.endswith("expected f4 or f8 of shape (6, 108), found f4 of shape (6, 12)")
