"""Scores of methods put side by side: what a comparison says, and how sure it is."""

import copy
import re

import numpy as np
import pytest
from compared_scores import COMPARED_IMAGES, SHIFT_RAD

from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.averages import difference
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.reports.comparison import compare
from symsol_annot.bench.scoring.reports.scores_file import read_scores
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.so3 import uniform_rotations


def rows_of(text):
    """Title to the other cells of each row of the first stratum, "all"."""
    first = text.split("\n\n")[1].splitlines()
    return {cells[0]: cells[1:] for cells in (re.split(r" {2,}", line.strip()) for line in first)}


def numbers_in(cell):
    return [float(number) for number in re.findall(r"[-+]?\d[\d.]*(?:e[-+]\d+)?", cell)]


def test_a_score_differs_from_itself_by_exactly_nothing(pair):
    scores, _ = pair[0]
    for track in scores.tracks.values():
        table = track.per_image
        for metrics in difference(table, table, scores.truth.strata).values():
            for figure in metrics.values():
                if figure.images >= 20:
                    assert (figure.value, figure.low, figure.high) == (0.0, 0.0, 0.0)
                else:
                    assert figure.value == 0.0 or figure.images == 0
                    assert np.isnan([figure.low, figure.high]).all()


def test_a_file_compared_with_itself_shows_zeros_only(documents, save):
    text = compare(save(documents[0], documents[0]))
    assert text.count("+0.0000 [+0.0000, +0.0000]") > 20
    assert re.findall(r"[-+]\d\.\d{4} \[|[-+]\d\.\d{4}$", text, flags=re.MULTILINE)
    assert set(re.findall(r"(?<!\w)[-+]\d\.\d{4}(?= \[|$)", text, flags=re.MULTILINE)) == {"+0.0000"}


def test_values_are_those_of_the_files_and_differences_are_second_minus_first(documents, save):
    rows = rows_of(compare(save(*documents)))
    titles = {metric.name: metric.title for metric in metrics_shown("hypotheses", Place.TABLES)}
    assert rows["all (40)"] == ["first: hypotheses (M = 1)", "second: hypotheses (M = 1)", "difference"]
    for metric, title in titles.items():
        if metric not in documents[0]["objects"]["tetX"]["hypotheses"]["all"]:
            continue
        first, second = (d["objects"]["tetX"]["hypotheses"]["all"][metric]["value"] for d in documents)
        shown_first, shown_second, shown_difference = rows[title]
        assert float(shown_first) == pytest.approx(first, abs=5.1e-5)
        assert float(shown_second) == pytest.approx(second, abs=5.1e-5)
        value, low, high = numbers_in(shown_difference)
        assert value == pytest.approx(second - first, abs=5.1e-5)
        assert low <= value <= high


def test_a_shift_of_every_image_is_found_by_pairing_and_not_without(documents, save):
    value, low, high = numbers_in(rows_of(compare(save(*documents)))["precision mean error, rad (5.9)"][2])
    first, second = (d["objects"]["tetX"]["hypotheses"]["all"]["precision_mean_error_rad"] for d in documents)
    assert 0 < low <= value <= high
    unpaired = np.hypot(first["high"] - first["low"], second["high"] - second["low"])
    assert high - low < unpaired / 10
    assert unpaired > 2 * SHIFT_RAD


def test_the_interval_of_a_difference_is_that_of_the_same_draws_on_both_sides(pair, documents, save):
    (first, _), (second, _) = pair
    tables = [scores.tracks["hypotheses"].per_image for scores in (first, second)]
    exact = difference(*tables, first.truth.strata)["all"]
    rows = rows_of(compare(save(*documents)))
    for metric in metrics_shown("hypotheses", Place.TABLES):
        if metric.name in exact:
            shown = numbers_in(rows[metric.title][2])
            figure = exact[metric.name]
            assert shown == pytest.approx([figure.value, figure.low, figure.high], abs=5.1e-5)


def test_small_differences_are_not_shown_as_nothing(documents, save):
    close = copy.deepcopy(documents[0])
    column = close["objects"]["tetX"]["per_image"]["hypotheses"]["precision_mean_error_rad"]
    column[:] = [value + 1e-7 for value in column]
    rows = rows_of(compare(save(documents[0], close)))
    assert rows["precision mean error, rad (5.9)"][2] == "+1.0e-07 [+1.0e-07, +1.0e-07]"


def test_several_methods_stand_beside_the_first(documents, save):
    rows = rows_of(compare(save(documents[1], documents[0], documents[1])))
    assert [cell.partition(":")[0] for cell in rows["all (40)"]] == [
        "second",
        "first",
        "difference",
        "second",
        "difference",
    ]
    assert all(cells[4] == "+0.0000 [+0.0000, +0.0000]" for title, cells in rows.items() if title != "all (40)")


def test_tracks_are_compared_that_two_files_have_and_their_warnings_are_shown(documents, save):
    text = compare(save(documents[1], documents[0]))
    assert "tetX, hypotheses" in text
    assert "tetX, classifier" not in text
    text = compare(save(documents[1], documents[0], documents[0]))
    assert "tetX, classifier; differences from first: classifier" in text
    assert "WARNING, first: it is on the grid of level 0" in text


def test_lines_are_aligned_and_have_no_trailing_blanks(documents, save):
    text = compare(save(documents[0], documents[0]))
    assert [line for line in text.splitlines() if line != line.rstrip()] == []
    tables = [
        block.splitlines() for block in text.split("\n\n") if block.startswith(("all", "shown", "hidden", "barely"))
    ]
    assert len(tables) == 4 * len(SCORINGS)
    for table in tables:
        assert len({len(line) for line in table if not line.startswith("WARNING")}) == 1


def test_a_file_that_was_written_is_read_back_whole(documents, save):
    for path, document in zip(save(*documents), documents, strict=True):
        assert read_scores(path) == document


def test_uniform_rotations_are_worse_than_the_first_method(tetX, documents, save, tmp_path):
    """A known sign: the difference of a bad method from a good one."""
    path = tmp_path / "uniform.h5"
    uniform = uniform_rotations(COMPARED_IMAGES, np.random.default_rng(1))[:, None]
    write_hypotheses(path, tetX, uniform, method="uniform")
    bad = report.to_document([score_file(path, tetX.folder)])
    rows = rows_of(compare(save(documents[0], bad)))
    assert numbers_in(rows["precision mean error, rad (5.9)"][2])[1] > 0.2
    assert numbers_in(rows["F-measure at 5 deg"][2])[0] < 0


def test_paths_may_be_text(documents, save):
    paths = save(documents[0], documents[1])
    assert compare([str(path) for path in paths]) == compare(paths)
