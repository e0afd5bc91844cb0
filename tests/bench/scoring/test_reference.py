"""Reference rows: methods whose scores are known before they are computed."""

import h5py
import numpy as np
import pytest
from bench_sets import small_set

from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.bench.scoring.reference import HYPOTHESES, ROWS, evenly_placed, score_row
from symsol_annot.bench.scoring.reports.comparison import compare
from symsol_annot.bench.scoring.reports.report import to_json
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import STANDARD_LEVEL

LEVEL = 1  # 576 rotations
GRID_REACH_RAD = np.radians(45.0)  # no rotation is that far from the nearest of them
IMAGES = {"tetX": 20, "cylO": 10}  # from 10 on, rotations are tried in other conventions
NAMES = list(IMAGES)
HYPOTHESES_SHARES = (
    "coverage_at_5_deg",
    "coverage_at_1_deg",
    "accuracy_at_5_deg",
    "f_measure_at_5_deg",
    "f_measure_at_1_deg",
)
HYPOTHESES_ERRORS = (
    "recall_mean_error_rad",
    "recall_mean_error_image_mean_rad",
    "precision_mean_error_rad",
)


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    return {name: small_set(folder, name, images) for name, images in IMAGES.items()}


@pytest.fixture(scope="module")
def rows(sets, tmp_path_factory):
    """Row to its scores document."""
    return {name: score_row(name, list(sets.values()), tmp_path_factory.mktemp(name), LEVEL) for name in ROWS}


@pytest.fixture(params=NAMES)
def name(request):
    return request.param


def values(document, name, track, stratum="all"):
    """Metric to value."""
    figures = document["objects"][name][track][stratum]
    return {metric: figure["value"] for metric, figure in figures.items()}


def warnings(document, name, track="classifier"):
    return document["objects"][name][track]["warnings"]


def is_said_to_depend_on_being_asked(document, name):
    return any("its answers depend on being asked, and this score does not rank" in w for w in warnings(document, name))


# --- the truth ---


@pytest.mark.parametrize("stratum", ["all", "shown", "hidden"])
def test_the_truth_has_all_hypotheses_right(rows, name, stratum):
    found = values(rows["truth"], name, "hypotheses", stratum)
    assert [found[metric] for metric in HYPOTHESES_SHARES] == [1.0] * len(HYPOTHESES_SHARES)
    assert max(found[metric] for metric in HYPOTHESES_ERRORS) < 1e-12


@pytest.mark.parametrize("stratum", ["all", "shown", "hidden"])
def test_the_truth_is_a_perfect_classifier(rows, name, stratum):
    found = values(rows["truth"], name, "classifier", stratum)
    ones = ("recall", "precision", "f_measure", "accuracy", "precision_beyond_half_degree", "f_measure_above_0.99")
    noughts = ("hard_negative_rate", "decoy_false_positive_rate", "grid_positive_rate", "nothing_predicted_rate")
    assert [found[metric] for metric in ones] == [1.0] * len(ones)
    assert [found[metric] for metric in noughts] == [0.0] * len(noughts)


def test_the_truth_is_the_best_density_that_the_grid_allows(rows, name):
    found = values(rows["truth"], name, "density")
    assert found["log_likelihood"] == pytest.approx(found["log_likelihood_ceiling"], abs=1e-10)
    assert found["log_likelihood_at_gt"] == pytest.approx(found["log_likelihood_at_gt_ceiling"], abs=1e-10)
    assert found["spread_rad"] == pytest.approx(found["spread_at_ceiling_rad"], abs=1e-10)
    assert 0.0 < found["spread_rad"] < GRID_REACH_RAD


# --- methods that know a part of it ---


def test_one_true_rotation_is_right_and_covers_its_share(rows, sets, name):
    found = values(rows["one-true-rotation"], name, "hypotheses")
    sizes = truth_of(sets[name]).set_sizes
    assert found["precision_mean_error_rad"] < 1e-12
    assert found["accuracy_at_1_deg"] == 1.0
    if name == "tetX":  # no two members are within 5 degrees
        assert found["coverage_at_5_deg"] == pytest.approx(len(sizes) / sizes.sum(), rel=1e-11)
        assert found["coverage_image_mean_at_5_deg"] == pytest.approx((1 / sizes).mean(), rel=1e-11)
    assert found["recall_mean_error_rad"] > 0.3
    assert "hard_negative_rate" not in found


def test_the_bodys_group_covers_everything_and_claims_what_the_marking_rules_out(rows, sets, name):
    known = truth_of(sets[name])
    hypotheses, classifier = (values(rows["body-group"], name, track) for track in ("hypotheses", "classifier"))
    assert hypotheses["recall_mean_error_rad"] < 1e-12
    assert hypotheses["coverage_at_1_deg"] == 1.0
    assert classifier["recall"] == classifier["hard_negative_rate"] == 1.0
    assert classifier["decoy_false_positive_rate"] == classifier["grid_positive_rate"] == 0.0
    if name == "tetX":
        shares = known.set_sizes / known.labels.symmetry_mask.shape[1]
        assert hypotheses["accuracy_at_5_deg"] == pytest.approx(shares.mean(), rel=1e-11)
    assert hypotheses["precision_mean_error_rad"] > 0.3
    assert rows["body-group"]["objects"][name]["hypotheses"]["M"] == len(known.labels.symmetry_group)


def test_rotations_placed_evenly_are_all_right_and_better_than_uniform_ones(rows, sets, name):
    even, uniform, one = (
        values(rows[row], name, "hypotheses") for row in ("evenly-placed", "uniform", "one-true-rotation")
    )
    assert even["precision_mean_error_rad"] < 1e-12
    assert even["accuracy_at_1_deg"] == 1.0
    assert even["recall_mean_error_rad"] < uniform["recall_mean_error_rad"] / 4
    assert even["recall_mean_error_rad"] < one["recall_mean_error_rad"] / 4
    assert even["f_measure_at_5_deg"] > 4 * uniform["f_measure_at_5_deg"]
    if name == "tetX":  # whose sets have 9 members at most: all are among the 30
        assert values(rows["truth"], name, "hypotheses") == pytest.approx(even, abs=1e-12)
    assert rows["evenly-placed"]["objects"][name]["hypotheses"]["M"] <= HYPOTHESES


def test_rotations_placed_evenly_are_within_half_their_step_of_every_member(sets, tmp_path):
    """A set of n members, a degree apart along its arcs, has a rotation every n / 30 degrees."""
    known = truth_of(sets["cylO"])
    evenly_placed(tmp_path / "preds.h5", sets["cylO"], known)
    with h5py.File(tmp_path / "preds.h5") as file:
        hypotheses, weights = file["hypotheses"][...], file["hypothesis_weights"][...]
    for i, size in enumerate(known.set_sizes):
        members, placed = known.labels.symmetry_set(i), hypotheses[i][weights[i] > 0]
        cosine = (np.einsum("aij,bij->ab", members, placed) - 1) / 2
        farthest_deg = np.degrees(np.arccos(np.clip(cosine.max(axis=1).min(), -1, 1)))
        assert len(placed) == min(size, HYPOTHESES)
        assert farthest_deg <= (size / HYPOTHESES / 2 + 0.5 if size > HYPOTHESES else 1e-5)


def test_uniform_rotations_know_nothing(rows, sets, name):
    found = values(rows["uniform"], name, "hypotheses")
    assert found["accuracy_at_5_deg"] < 0.1
    assert found["precision_mean_error_rad"] > 0.3
    assert rows["uniform"]["objects"][name]["hypotheses"]["M"] == HYPOTHESES


def test_the_truth_rounded_to_the_grid_is_off_by_less_than_the_grids_reach(rows, name):
    hypotheses, classifier = (values(rows["rounded-to-grid"], name, track) for track in ("hypotheses", "classifier"))
    assert 0.01 < hypotheses["precision_mean_error_rad"] < GRID_REACH_RAD
    assert 0.01 < hypotheses["recall_mean_error_rad"] < GRID_REACH_RAD
    assert classifier["recall"] == 1.0
    assert 0.0 < classifier["precision"] < 1.0
    assert classifier["hard_negative_rate"] == classifier["decoy_false_positive_rate"] == 0.0
    assert classifier["grid_positive_rate"] > 0.0
    assert not is_said_to_depend_on_being_asked(rows["rounded-to-grid"], name)


# --- what must not rank ---


def test_saying_yes_to_every_query_looks_perfect_and_is_found_out(rows, name):
    found = values(rows["yes-to-queries"], name, "classifier")
    assert found["recall"] == found["precision"] == found["f_measure"] == 1.0
    assert found["decoy_false_positive_rate"] == found["hard_negative_rate"] == 1.0
    assert found["grid_positive_rate"] == 0.0
    assert is_said_to_depend_on_being_asked(rows["yes-to-queries"], name)
    assert rows["yes-to-queries"]["ranks"] is False


def test_no_row_has_a_note(rows, name):
    entries = {row: document["objects"][name] for row, document in rows.items()}
    tracks = [(row, track) for row, entry in entries.items() for track in SCORINGS if track in entry]
    assert len(tracks) > len(ROWS)
    assert [(row, track) for row, track in tracks if entries[row][track]["notes"]] == []


@pytest.mark.parametrize("row", [row for row in ROWS if row != "yes-to-queries"])
def test_no_other_row_is_said_to_depend_on_being_asked(rows, row, name):
    entry = rows[row]["objects"][name]
    assert "classifier" not in entry or not is_said_to_depend_on_being_asked(rows[row], name)


@pytest.mark.parametrize(("row", "ranks"), [("body-group", True), ("yes-to-queries", False)])
def test_on_the_standard_grid_rows_rank_unless_they_depend_on_being_asked(sets, tmp_path, row, ranks):
    document = score_row(row, [sets["tetX"]], tmp_path)
    assert document["objects"]["tetX"]["classifier"]["grid_level"] == STANDARD_LEVEL
    assert document["ranks"] is ranks
    assert len(warnings(document, "tetX")) == (0 if ranks else 1)


# --- all rows ---


def test_rows_have_methods_of_their_own_and_can_be_compared(rows, tmp_path):
    assert len({document["method"] for document in rows.values()}) == len(ROWS)
    for row, document in rows.items():
        (tmp_path / f"{row}.json").write_text(to_json(document))
    text = compare([tmp_path / f"{row}.json" for row in ROWS])
    for name in IMAGES:
        for track in ("hypotheses", "classifier"):
            assert f"{name}, {track}; differences from truth" in text


def test_the_same_sets_give_the_same_rows(sets, rows, tmp_path):
    again = score_row("uniform", [sets["tetX"]], tmp_path, LEVEL)
    assert again["objects"]["tetX"] == rows["uniform"]["objects"]["tetX"]


def test_two_sets_of_one_object_are_refused_at_once(sets, tmp_path):
    with pytest.raises(ScoresError, match="more than one of the sets is of the same object"):
        score_row("truth", [sets["tetX"], sets["cylO"], sets["tetX"]], tmp_path)
    assert list(tmp_path.iterdir()) == []
