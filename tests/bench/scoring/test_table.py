"""The table of the tracks' scorings and of their metrics."""

from dataclasses import replace

import numpy as np
import pytest
from messy_predictions import Style, write_messy

from symsol_annot.bench.scoring.metric import LOWER, Metric, Place
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of, metrics_shown
from symsol_annot.bench.scoring.scoring import score_file


@pytest.fixture(scope="module")
def every_metric(sets, tmp_path_factory):
    """Scores with all that scorers return: of an object with arcs, with weights, down to the lowest floor."""
    folder, truths = sets
    path = write_messy(
        tmp_path_factory.mktemp("every") / "preds.h5", truths["cylO"], Style(level=0, floor=0.0, has_weights=True)
    )
    return score_file(path, folder).tracks


def test_the_table_has_each_metric_that_a_scorer_returns_once_and_no_other(every_metric):
    assert set(every_metric) == set(SCORINGS)
    for track, scoring in SCORINGS.items():
        assert [metric.name for metric in scoring.metrics] == list(every_metric[track].per_image.values)


def test_metrics_are_pooled_that_weigh_an_image_by_its_set(sets, every_metric):
    sizes = np.array([sum(mask) for mask in sets[1]["cylO"].mask])
    assert len(set(sizes)) > 2
    for track, scoring in SCORINGS.items():
        for metric in scoring.metrics:
            table = every_metric[track].per_image
            expected = sizes if metric.is_pooled else np.ones(len(sizes))
            is_defined = ~np.isnan(table.values[metric.name])
            assert table.weights[metric.name].tolist() == np.where(is_defined, expected, 0).tolist(), metric


def test_an_image_without_a_value_weighs_nothing_and_each_other_1_unless_they_are_pooled():
    metric = Metric("error_rad", LOWER, Place.TABLES, lambda values: values, "error")
    values, sizes = np.array([0.1, np.nan, 0.3]), np.array([2, 3, 4])
    assert metric.weights(values, sizes).tolist() == [1, 0, 1]
    assert replace(metric, is_pooled=True).weights(values, sizes).tolist() == [2, 0, 4]


def test_a_title_is_indented_where_the_metric_is_a_detail_alone():
    metric = Metric("error_rad", LOWER, Place.TABLES, lambda values: values, "error", equation="7")
    assert (metric.title, metric.label) == ("error (7)", "error (7)")
    assert replace(metric, is_detail=True, equation="").label == "  error"


def test_each_place_is_one_of_its_own_behind_those_that_show_more():
    assert [place.name for place in sorted(Place)] == ["FILE", "TABLES", "LEADERBOARD", "SUMMARY"]


def test_what_tables_show_has_a_row_of_its_own_and_what_ranks_is_better_on_one_side_and_has_a_column():
    for track, scoring in SCORINGS.items():
        in_tables = [metric for metric in scoring.metrics if metric.place > Place.FILE]
        assert sorted(metric.row for metric in in_tables) == list(range(1, len(in_tables) + 1))
        assert not metrics_shown(track, Place.TABLES)[0].is_detail
        by = metric_of(track, scoring.track.ranked_by)
        assert by.better
        assert by.place >= Place.LEADERBOARD
