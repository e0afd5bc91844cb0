"""The faults of a predictions file: counted by rows, and listed at once."""

import h5py
import numpy as np
from changed_predictions import CELLS, MISSING, changed, linked, sparse


def test_rows_that_share_a_fault_are_counted_and_the_first_of_them_named(faults, valid):
    asked = changed(valid[0]["query_probability"], np.s_[:, 0], 2.0)
    assert faults({"query_probability": asked}).endswith("(1 + np.exp(-x)): rows 0, 1, 2, 3, 4 and 1 more")


def test_all_faults_of_a_file_are_listed_at_once(faults, valid):
    columns = {
        "hypotheses": changed(valid[0]["hypotheses"], (1, 0), -np.eye(3)),
        "hypothesis_weights": changed(valid[0]["hypothesis_weights"], 2, 0.0),
        "query_probability": changed(valid[0]["query_probability"], (3, 0), 7.0),
        **sparse("density", [[5, 5], [CELLS], [], [], [], []]),
        "notes": np.zeros(3),
    }
    found = faults(columns, {"method": MISSING, "fingerprint": "0"}, edit=linked("grid_indices", h5py.SoftLink("/x")))
    expected = [
        "the file: 'notes' is not part of the format",
        "classifier: 'grid_indices' is a soft link to '/x', where a data set of numbers in this file belongs",
        "the file: attribute 'method' is missing",
        "the file: attribute 'fingerprint': expected",
        "hypotheses: 'hypothesis_weights' has no positive one: row 2",
        "hypotheses: 'hypotheses' holds a matrix that is no rotation",
        "density: 'density_indices' has an index outside 0 to 71: row 1",
        "density: 'density_indices' are not ascending, or one is repeated: row 0",
    ]
    assert len(found.splitlines()) == len(expected)
    assert all(any(line.startswith(what) for line in found.splitlines()) for what in expected), found
