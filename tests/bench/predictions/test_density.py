"""Reading the track of a density: log-probabilities of the grid's cells."""

import numpy as np
import pytest
from changed_predictions import CELLS, figures, sparse, with_rows
from valid_predictions import IMAGES


def test_a_density_may_list_every_cell(scores):
    offsets, indices = with_rows(*[np.arange(CELLS)] * IMAGES)
    logs = np.full(len(indices), -np.log(CELLS))
    logs[::CELLS] = -700.0
    logs[1::CELLS] = np.log(2 / CELLS)
    columns = {"density_offsets": offsets, "density_indices": indices, "density_log_probabilities": logs}
    assert all(np.isfinite(value) for value in figures(scores(columns, tracks=["density"])).values())


@pytest.mark.parametrize("value", [1e-9, 0.5, np.nan, np.inf, -np.inf, -1.1e6, -1e308])
def test_log_probabilities_that_are_none_or_vanish_are_named_by_row(faults, value):
    columns = sparse("density", [[1]] * IMAGES)
    columns["density_log_probabilities"][3] = value
    found = faults(columns)
    assert found.startswith("density: 'density_log_probabilities' are not in [-1e+06, 0]")
    assert found.endswith(": row 3")


def test_a_density_must_leave_something_to_the_cells_that_it_does_not_list(faults):
    columns = sparse("density", [[0], [1, 2], [3, 4], [], [5], []])
    columns["density_log_probabilities"][:5] = [-0.1, *np.log([0.5, 0.5, 0.7, 0.7])]
    found = faults(columns)
    assert "image's scipy.special.logsumexp over the whole grid: rows 1 (they hold 1), 2 (they hold 1.4)" in found


def test_a_density_that_lists_every_cell_must_add_up_to_1(faults):
    columns = sparse("density", [np.arange(CELLS), [], [], [], [], []])
    columns["density_log_probabilities"][:] = np.log(0.9 / CELLS)
    assert faults(columns).endswith("logsumexp over the whole grid: row 0 (they hold 0.9)")
