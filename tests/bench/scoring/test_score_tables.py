"""Scores as tables for people."""

import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_set
from reported_scores import IMAGES

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load


@pytest.fixture(scope="module")
def document(reported):
    return reported.document


def test_tables_name_metrics_that_there_are(document):
    for track in SCORINGS:
        names = {metric.name for metric in metrics_shown(track, Place.TABLES)} - {F_UNWEIGHTED}  # of files with weights
        assert names <= set(document["objects"]["cylO"][track]["all"])


def blocks(text):
    """The tables of a text: runs of lines whose first cell is followed by others."""
    return [block.splitlines() for block in text.split("\n\n") if block]


def cells(line):
    return re.split(r" {2,}", line.strip())


@pytest.fixture(scope="module")
def printed(document):
    return tables.tables(document, intervals=True, width=150)


def table_of(printed, name, track):
    about = printed.split("all objects, all images")[0]
    section = about[about.index(f"{name}, test split") :]
    return next(block for block in blocks(section) if block[0].startswith(track))


@pytest.mark.parametrize("name", IMAGES)
@pytest.mark.parametrize("track", SCORINGS)
def test_a_table_is_aligned_and_has_a_column_a_stratum_and_a_row_a_metric(printed, document, name, track):
    table = table_of(printed, name, track)
    entry = document["objects"][name]
    rows = [metric for metric in metrics_shown(track, Place.TABLES) if metric.name in entry[track]["all"]]
    lines = table[: 1 + len(rows)]
    assert cells(lines[0]) == [entry[track]["name"], *(f"{s} ({entry['strata'][s]})" for s in STRATA)]
    assert len({len(line) for line in lines}) == 1
    for line, metric in zip(lines[1:], rows, strict=True):
        arrow = {"higher": " ↑", "lower": " ↓", "": ""}[metric.better]
        assert line.startswith(("  " if metric.is_detail else "") + metric.title + arrow + " ")
        for stratum, cell in zip(STRATA, cells(line)[1:], strict=True):
            assert_cell_says(cell, entry[track][stratum][metric.name])


def assert_cell_says(cell, figure):
    if figure["value"] is None:
        assert cell == "-"
        return
    value, _, interval = cell.partition(" ")
    assert float(value) == pytest.approx(figure["value"], rel=0.06, abs=5.1e-5 if abs(figure["value"]) >= 1e-3 else 0)
    if figure["low"] is None:
        assert interval == ""
    else:
        low, high = (float(number) for number in interval.strip("[]").split(", "))
        assert (low, high) == pytest.approx((figure["low"], figure["high"]), rel=0.06, abs=5.1e-5)


def test_tables_fit_a_screen_and_have_no_trailing_blanks_and_no_nan(printed):
    lines = printed.splitlines()
    assert 116 < max(map(len, lines)) <= 150
    assert [line for line in lines if line != line.rstrip()] == []
    assert not re.search(r"\bnan\b|\binf\b|None", printed)


def test_warnings_and_the_note_on_f_are_shown(printed):
    assert printed.count("WARNING: it is on the grid of level 0") == 2 * len(IMAGES)
    assert printed.count("F is not compared from one stratum to another") == len(IMAGES)  # below the classifiers alone
    assert printed.count("p > 0.8, grid of level 0; the sweep is in --json") == len(IMAGES)


@pytest.mark.parametrize(
    ("value", "shown", "signed"),
    [
        (0.0, "0.0000", "+0.0000"),
        (1.0, "1.0000", "+1.0000"),
        (-2.28949, "-2.2895", "-2.2895"),
        (0.001, "0.0010", "+0.0010"),
        (1.234e-9, "1.2e-09", "+1.2e-09"),
        (-1.234e-9, "-1.2e-09", "-1.2e-09"),
    ],
)
def test_small_figures_are_not_shown_as_nothing(value, shown, signed):
    assert (tables.short(value), tables.short(value, "+")) == (shown, signed)


def test_several_files_give_the_benchmarks_table(printed, document):
    table = printed[printed.index("all objects, all images") :]
    for track in SCORINGS:
        metrics = [metric.name for metric in metrics_shown(track, Place.SUMMARY)]
        lines = next(block for block in blocks(table) if block[0].startswith(track))
        assert cells(lines[0]) == [track, *IMAGES, "mean"]
        if track == "hypotheses":
            counts = [str(document["objects"][name][track]["M"]) for name in IMAGES]
            assert cells(lines.pop(1)) == ["M, hypotheses per image", *counts]
        assert len(lines) == 1 + len(metrics)
        assert len({len(line) for line in lines}) == 1
        for line, metric in zip(lines[1:], metrics, strict=True):
            values = [document["objects"][name][track]["all"][metric]["value"] for name in IMAGES]
            shown = [float(cell) for cell in cells(line)[1:]]
            assert shown == pytest.approx([*values, np.mean(values)], rel=0.06, abs=5.1e-5)


def test_one_file_gives_no_benchmarks_table_and_one_without_marking_no_strata(tmp_path):
    dataset = load(make_set(tmp_path, "tet", test=3, size=16))
    path = tmp_path / "preds.h5"
    write_hypotheses(path, dataset, dataset.labels().rotation[:, None], method="mine")
    document = report.to_document([score_file(path, tmp_path)])
    assert document["objects"]["tet"]["strata"] == {"all": 3}
    assert document["ranks"] is True
    printed = tables.tables(document)
    assert printed.startswith("tet, test split, 3 images: mine\n  hypotheses: F-measure at 5 deg ")
    assert "\n\nhypotheses (M = 1) " in printed
    for words in ("all objects", "shown", "F is not compared", "[", "WARNING"):
        assert words not in printed


def test_tracks_that_only_some_objects_have_are_averaged_over_those(document):
    partial = json.loads(json.dumps(document))
    del partial["objects"]["cylO"]["density"]
    table = tables.tables(partial).partition("all objects, all images")[2]
    block = next(block for block in blocks(table) if block[0].startswith("density"))
    assert cells(block[0]) == ["density", "tetX", "mean"]
    assert cells(block[1])[1] == cells(block[1])[2]


@pytest.mark.parametrize("width", [40, 60, 80, 116, 300])
@pytest.mark.parametrize("intervals", [False, True])
def test_tables_fit_the_width_and_lose_no_figure(document, width, intervals):
    printed = tables.tables(document, intervals=intervals, width=width)
    longest = max(len(line) for line in printed.splitlines())
    assert longest <= width or (width == 40 and intervals and longest <= 52)  # a title's 24, and one figure's interval
    assert ("[" in printed.replace("[of two,", "")) is intervals
    for name, entry in document["objects"].items():
        for track in SCORINGS:
            for metric in metrics_shown(track, Place.TABLES):
                for stratum in STRATA if metric.name in entry[track]["all"] else ():
                    assert tables.cell(entry[track][stratum][metric.name], intervals=intervals) in printed, name


def test_a_headline_stands_with_chance_and_the_best_possible(document, printed):
    for entry in document["objects"].values():
        for track in SCORINGS:
            headline = entry[track]["headline"]
            assert headline["value"] == entry[track]["all"][headline["metric"]]["value"]
            assert headline["chance"] < headline["best_possible"]
            assert headline["value"] <= headline["best_possible"]
            value, chance, best = (tables.short(headline[key]) for key in ("value", "chance", "best_possible"))
            assert f"{value} (chance {chance}, best possible {best})" in " ".join(printed.split())
            (metric,) = (metric for metric in SCORINGS[track].metrics if metric.name == headline["metric"])
            assert f"\n  {track}: {metric.words} {value} (" in printed


def test_chance_and_the_best_possible_are_what_such_predictions_get(reported, tmp_path):
    """Uniform rotations, everything claimed and a uniform density get chance; one true rotation gets less than 1."""
    dataset = reported.sets["cylO"]
    labels, rng = dataset.labels(), np.random.default_rng(5)
    path, options = tmp_path / "preds.h5", {"method": "mine", "level": 0}
    write_hypotheses(path, dataset, uniform_rotations(22 * 40, rng).reshape(22, 40, 3, 3), method="mine")
    write_classifier(path, dataset, lambda i, R: np.ones(len(R)), **options)
    write_density(path, dataset, lambda i, R: np.zeros(len(R)), **options)
    tracks = score_file(path, dataset.folder).tracks
    assert tracks["hypotheses"].headline.chance == pytest.approx(tracks["hypotheses"].headline.value, abs=0.005)
    assert tracks["classifier"].headline.value == pytest.approx(tracks["classifier"].headline.chance)
    assert tracks["density"].headline.value == pytest.approx(tracks["density"].headline.chance)

    one = tmp_path / "one.h5"
    write_hypotheses(one, dataset, labels.rotation[:, None], method="mine")
    headline = score_file(one, dataset.folder).tracks["hypotheses"].headline
    coverage = np.minimum(1, 11 / labels.set_sizes)
    assert headline.best_possible == pytest.approx(np.mean(2 * coverage / (1 + coverage)))
    assert headline.value <= headline.best_possible


def test_the_worst_images_are_named_with_their_figure(document, printed, reported):
    for one in reported.scores:
        for track, found in one.tracks.items():
            values = found.per_image.values[found.headline.metric]
            worst = np.argsort(values, kind="stable")[:10]
            line = "worst images: " + ", ".join(f"{i} ({tables.short(values[i])})" for i in worst)
            assert " ".join(line.split()) in " ".join(printed.split()), track


@given(
    rows=st.integers(1, 4).flatmap(
        lambda n: st.lists(st.lists(st.text("ab", min_size=1), min_size=n, max_size=n), min_size=1)
    )
)
@settings(deadline=None, max_examples=50)
def test_aligned_keeps_every_cell_in_its_column(rows):
    lines = tables.aligned(rows)
    assert [line.split() for line in lines] == rows
    assert len({len(line) for line in lines}) == 1 or len(rows[0]) == 1
