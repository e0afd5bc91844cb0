"""Reading rows of grid cells, which classifiers and densities have: offsets and indices."""

import numpy as np
import pytest
from changed_predictions import CELLS, GRID, sparse
from valid_predictions import IMAGES

UNSORTED = "are not ascending, or one is repeated"
INDICES = {
    "unsorted": ([1, 0], UNSORTED),
    "repeated": ([7, 7], UNSORTED),
    "negative": ([-1, 0], "has an index outside 0 to 71"),
    "out of range": ([0, CELLS], "has an index outside 0 to 71"),
    "far out of range": ([0, 2**63 - 1], "has an index outside 0 to 71"),
}


@pytest.mark.parametrize("track", GRID)
@pytest.mark.parametrize("kind", INDICES)
def test_grid_indices_that_are_unsorted_repeated_or_outside_are_named_by_row(faults, track, kind):
    indices, reason = INDICES[kind]
    found = faults(sparse(track, [[3], [], [70, 71], indices, [0], []]))
    assert found == f"{track}: '{GRID[track][0]}_indices' {reason}: row 3"


@pytest.mark.parametrize("track", GRID)
def test_indices_may_fall_from_one_image_to_the_next(scores, track):
    scored = scores(sparse(track, [[70, 71], [], [0, 1], [0], [], []])).tracks[track]
    assert all(figure.images + figure.undefined == IMAGES for figure in scored.figures["all"].values())


OFFSETS = {
    "a late start": [1, 1, 2, 3, 4, 5, 6],
    "an early end": [0, 1, 2, 3, 4, 5, 5],
    "a late end": [0, 1, 2, 3, 4, 5, 7],
    "a step back": [0, 3, 2, 3, 4, 5, 6],
    "a negative one": [0, -1, 2, 3, 4, 5, 6],
    "a wrap around": [0, 2**63 - 1, -(2**63), 3, 4, 5, 6],
}


@pytest.mark.parametrize("track", GRID)
@pytest.mark.parametrize("kind", OFFSETS)
def test_offsets_that_do_not_ascend_from_end_to_end_are_named(faults, track, kind):
    columns = sparse(track, [[1]] * IMAGES)
    name = f"{GRID[track][0]}_offsets"
    found = faults({**columns, name: np.array(OFFSETS[kind])})
    assert found.startswith(
        f"{track}: '{name}': expected ascending numbers from 0 to 6 with steps of at most 72, found"
    )


@pytest.mark.parametrize("track", GRID)
def test_an_image_cannot_list_more_cells_than_there_are(faults, track):
    found = faults(sparse(track, [np.arange(CELLS + 1), *[[]] * (IMAGES - 1)]))
    assert "with steps of at most 72, found 0 to 73 with steps of 0 to 73" in found


@pytest.mark.parametrize("track", GRID)
def test_indices_and_values_must_be_as_many(faults, track):
    columns = sparse(track, [[1]] * IMAGES)
    name = GRID[track][1]
    assert faults({**columns, name: columns[name][:-1]}).endswith("_indices' has 6 entries, but '" + f"{name}' 5")


@pytest.mark.parametrize("track", GRID)
def test_offsets_of_another_length_or_type_are_named_with_them(faults, track):
    columns, name = sparse(track, [[1]] * IMAGES), f"{GRID[track][0]}_offsets"
    assert "expected i8 or i4 of shape (7), found i8 of shape (6,)" in faults({**columns, name: columns[name][:-1]})
    assert "found f8 of shape (7,)" in faults({**columns, name: columns[name].astype("f8")})
