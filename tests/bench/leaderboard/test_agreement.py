"""Whether an order by one rotation is that by the whole set: methods whose orders are known."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from made_boards import IMAGES, add_result, page_of, tables_of

from symsol_annot.bench.leaderboard.agreement import BY_SET, agreements
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_density
from symsol_annot.bench.scoring.scorers.table import metric_of
from symsol_annot.rotations.grid import STANDARD_LEVEL, GridIndex


def put(grid, rotations, mass, size):
    """Return log-probabilities: a mass shared by the cells of rotations, the rest by all others."""
    cells = np.unique(grid.nearest(rotations))
    p = np.full(size, (1.0 - mass) / (size - len(cells)))
    p[cells] = mass / len(cells)
    return np.log(p)


@pytest.fixture(scope="module")
def board(original, images, tmp_path_factory):
    """Three methods: one is sure of R_gt, one of the whole set, and one less sure of it; not to be written to."""
    tmp_path = tmp_path_factory.mktemp("agreement")
    folder = Path(shutil.copytree(original, tmp_path / "board"))
    labels, grid = images.labels(), GridIndex(STANDARD_LEVEL)
    methods = {
        "one": lambda i: (labels.rotation[i][None], 0.99),
        "set": lambda i: (labels.members(i), 0.95),
        "less": lambda i: (labels.members(i), 0.5),
    }
    for name, of in methods.items():
        path = tmp_path / f"{name}.h5"
        write_density(
            path,
            images,
            lambda i, R, of=of: put(grid, *of(i), len(R)).astype(np.float32),
            method=name,
            level=STANDARD_LEVEL,
            batch_size=2**19,
            floor=1e-9,
        )
        add_result(folder / "tiny", f"r-{name}", path, images)
    return folder


def test_a_method_that_is_sure_of_one_rotation_falls_behind_by_the_set(board):
    found = {(one.track, one.metric): one for one in agreements(read_leaderboard(board), "tiny")}
    assert set(found) == {("density", "log_likelihood"), ("density", "spread_rad")}  # the others have too few methods
    by_set = found["density", "log_likelihood"]
    assert by_set.methods == 3
    assert by_set.tau == pytest.approx(-1.0 / 3.0)  # "one" falls behind both
    assert by_set.low <= by_set.tau <= by_set.high
    assert {(pair.first, pair.second) for pair in by_set.inversions} == {
        ("The r-one one", "The r-set one"),
        ("The r-one one", "The r-less one"),
    }
    for pair in by_set.inversions:
        assert len(set(pair.images)) == 3
        assert all(0 <= image < IMAGES for image in pair.images)
    by_spread = found["density", "spread_rad"]
    assert by_spread.tau == 1.0  # what is near any member is near the set
    assert by_spread.inversions == ()


def test_the_images_named_are_those_whose_set_is_missed_most(board, images):
    by_set = next(agreements(read_leaderboard(board), "tiny"))
    sizes = images.labels().set_sizes
    pair = next(pair for pair in by_set.inversions if pair.second == "The r-set one")
    assert min(sizes[list(pair.images)]) >= np.median(sizes)


def test_the_page_tells_it(board):
    page = page_of(board)
    rows = tables_of(page)["tiny, one rotation or the whole set"]
    assert rows[0][1:] == ["log-likelihood, density", "spread, rad, density"]
    assert rows[2][0] == "tetX"
    assert rows[2][1].startswith("-0.33<br>[")
    assert rows[2][1].endswith("3 methods")
    assert "*The r-one one* is ahead of *The r-set one* at R_gt, and behind it by log-likelihood of density" in page


def test_two_methods_have_no_order_to_speak_of(folder):
    assert list(agreements(read_leaderboard(folder), "tiny")) == []
    assert "one rotation or the whole set" not in page_of(folder)


def test_what_is_compared_are_metrics_that_scores_have():
    assert [metric_of(track, metric).name for track, metric in BY_SET] == [metric for _, metric in BY_SET]
