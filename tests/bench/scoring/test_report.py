"""Scores as a document, as tables for people, and as a row an image."""

import csv
import hashlib
import io
import json
import math
import re

import h5py
import numpy as np
import pytest
import scipy
from bench_sets import small_set
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_set

from symsol_annot import __version__
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring import report, tables
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.report import STRATA
from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import grid_sha256
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load

LEVEL, IMAGES = 0, {"tetX": 24, "cylO": 22}
METHOD = 'a  method [of two,  "words"] {mine}'


def write_all_tracks(path, dataset, method=METHOD):
    """Predictions that are neither good nor bad; some images have no positive, and some no rejected candidate."""
    labels, rng = dataset.labels(), np.random.default_rng(3)
    strays = uniform_rotations(len(dataset), rng)
    write_hypotheses(path, dataset, lambda i: np.stack([labels.symmetry_set(i)[-1], strays[i]]), method=method)
    level = {"method": method, "level": LEVEL}
    write_classifier(path, dataset, lambda i, R: np.where(i % 3, 0.5 + 0.5 * np.sin(5 * R[:, 0, 0]), 0.0), **level)
    write_density(path, dataset, lambda i, R: 3.0 * R[:, 1, 1] * labels.rotation[i][1, 1], **level)
    return path


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets")
    return {name: small_set(folder, name, images) for name, images in IMAGES.items()}


@pytest.fixture(scope="module")
def paths(sets, tmp_path_factory):
    folder = tmp_path_factory.mktemp("predictions")
    return [write_all_tracks(folder / f"{name}.h5", dataset) for name, dataset in sets.items()]


@pytest.fixture(scope="module")
def scores(sets, paths):
    return [score_file(path, dataset.folder) for path, dataset in zip(paths, sets.values(), strict=True)]


@pytest.fixture(scope="module")
def document(scores, paths):
    return report.to_document(scores)


def strictly(text):
    """Read JSON that any reader would take: without NaN, without an infinity, without a name twice."""

    def once(pairs):
        assert len({name for name, _ in pairs}) == len(pairs)
        return dict(pairs)

    def refuse(word):
        pytest.fail(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse, object_pairs_hook=once)


def at(document, path):
    for name in path.split("."):
        document = document[name]
    return document


# --- the document ---


@pytest.mark.parametrize(
    "path",
    [
        "objects.cylO.hypotheses.all.recall_mean_error_rad",
        "objects.cylO.hypotheses.all.coverage_at_5_deg",
        "objects.cylO.hypotheses.all.precision_mean_error_rad",
        "objects.cylO.hypotheses.all.accuracy_at_5_deg",
        "objects.cylO.hypotheses.shown.precision_mean_error_continuous_rad",
        "objects.cylO.classifier.all.recall",
        "objects.cylO.classifier.all.precision",
        "objects.cylO.classifier.all.f_measure",
        "objects.cylO.classifier.hidden.hard_negative_rate",
        "objects.cylO.density.all.log_likelihood",
        "objects.cylO.density.all.spread_rad",
        "objects.tetX.density.barely.log_likelihood",
    ],
)
def test_a_figure_has_the_path_that_is_promised_and_a_value_with_its_interval(document, path):
    figure = at(strictly(report.to_json(document)), path)
    assert list(figure) == ["value", "low", "high", "images", "undefined"]
    _, name, _, stratum, _ = path.split(".")
    assert figure["images"] + figure["undefined"] == document["objects"][name]["strata"][stratum]
    if figure["images"] >= 20:
        assert figure["low"] <= figure["value"] <= figure["high"]
    else:
        assert figure["low"] is figure["high"] is None


def test_every_object_has_every_track_and_every_stratum_with_the_same_metrics(document):
    for name, images in IMAGES.items():
        entry = document["objects"][name]
        assert set(entry["strata"]) == set(STRATA)
        assert entry["strata"]["all"] == entry["strata"]["shown"] + entry["strata"]["hidden"] == images
        for track in SCORINGS:
            metrics = [list(entry[track][stratum]) for stratum in STRATA]
            assert metrics == metrics[:1] * 4
            assert len(metrics[0]) > 5


def test_tables_name_metrics_that_there_are(document):
    for track in SCORINGS:
        names = {metric.name for metric in metrics_shown(track, Place.TABLES)} - {F_UNWEIGHTED}  # of files with weights
        assert names <= set(document["objects"]["cylO"][track]["all"])


def test_the_document_says_what_it_is_about_and_with_what_it_was_made(document, sets, paths):
    assert (document["format"], document["format_version"]) == ("symsol-annot scores", 1)
    assert document["method"] == METHOD
    assert document["versions"] == {
        "symsol-annot": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "h5py": h5py.__version__,
    }
    assert document["bootstrap"] == {"draws": 2000, "interval": 0.95, "min_images": 20}
    for path, (name, dataset) in zip(paths, sets.items(), strict=True):
        entry = document["objects"][name]
        manifest = json.loads((dataset.folder / "manifest.json").read_text())
        assert entry["fingerprint"] == dataset.fingerprint
        assert len(entry["fingerprint"]) == len(manifest["fingerprint"]) == 64
        assert (entry["split"], entry["images"]) == ("test", IMAGES[name])
        assert entry["predictions"] == {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        with h5py.File(path) as file:
            assert entry["group_sha256"] == file.attrs["group_sha256"]
        for track in ("classifier", "density"):
            assert (entry[track]["grid_level"], entry[track]["grid_sha256"]) == (LEVEL, grid_sha256(LEVEL))
        assert (entry["classifier"]["floor"], entry["classifier"]["threshold"]) == (0.1, 0.8)
        assert (entry["hypotheses"]["M"], entry["hypotheses"]["name"]) == (2, "hypotheses (M = 2)")


def test_the_text_is_strict_json_of_the_document_with_a_line_a_list(document):
    text = report.to_json(document)
    assert strictly(text) == document
    assert text.endswith("}\n")
    assert not re.search(r"\bNaN\b|Infinity", text)
    assert len(re.findall(r'^ +"set_size": \[[\d, ]+\],$', text, flags=re.MULTILINE)) == 2
    assert max(len(line) for line in text.splitlines() if "[" not in line) < 200


@given(text=st.text(), numbers=st.lists(st.one_of(st.none(), st.floats(allow_nan=False, allow_infinity=False))))
@settings(deadline=None, max_examples=100)
def test_no_text_and_no_list_is_changed_by_how_it_is_written(text, numbers):
    document = {"method": text, "lists": [[text, text], numbers, [[], {}]], text: {"a": numbers}}
    assert strictly(report.to_json(document)) == document


def test_what_is_undefined_is_null_and_counted(document):
    figure = document["objects"]["tetX"]["hypotheses"]["barely"]["coverage_at_5_deg"]
    assert figure == {"value": None, "low": None, "high": None, "images": 0, "undefined": 0}
    entry = document["objects"]["cylO"]
    hard = entry["classifier"]["all"]["hard_negative_rate"]
    column = entry["per_image"]["classifier"]["hard_negative_rate"]
    assert hard["undefined"] == column.count(None)
    assert hard["images"] == IMAGES["cylO"] - column.count(None)


def test_figures_follow_from_the_images_that_the_document_lists(document):
    """Weighted means, written out anew."""
    pooled = {"recall_mean_error_rad", "coverage_at_5_deg"}
    for entry in document["objects"].values():
        listed = entry["per_image"]
        strata = {"all": range(entry["images"]), **listed["strata"]}
        for track in SCORINGS:
            for metric, values in listed[track].items():
                for stratum, images in strata.items():
                    known = [i for i in images if values[i] is not None]
                    weights = [listed["set_size"][i] if metric in pooled else 1 for i in known]
                    found = entry[track][stratum][metric]["value"]
                    if known:
                        mean = math.fsum(w * values[i] for w, i in zip(weights, known, strict=True)) / sum(weights)
                        assert found == pytest.approx(mean, rel=1e-10, abs=1e-12)
                    else:
                        assert found is None


def test_a_score_on_another_grid_does_not_rank_and_says_why(document):
    assert document["ranks"] is False
    for entry in document["objects"].values():
        for track in ("classifier", "density"):
            assert "it is on the grid of level 0; scores on other levels than 4 do not rank" in entry[track]["warnings"]
        assert entry["hypotheses"]["warnings"] == []


# --- several files ---


def test_two_files_about_one_object_are_refused(scores, paths):
    with pytest.raises(ScoresError, match="more than one of the files is about tetX; score one file per object"):
        report.to_document([scores[0], scores[1], scores[0]])


def test_files_of_two_methods_are_refused(scores, paths, sets, tmp_path):
    other = tmp_path / "other.h5"
    write_hypotheses(other, sets["cylO"], lambda i: np.eye(3)[None], method="another")
    with pytest.raises(ScoresError, match=r"the files are of different methods \(a  method .*, another\)"):
        report.to_document([scores[0], score_file(other, sets["cylO"].folder)])


# --- the tables ---


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


def test_chance_and_the_best_possible_are_what_such_predictions_get(sets, tmp_path):
    """Uniform rotations, everything claimed and a uniform density get chance; one true rotation gets less than 1."""
    dataset = sets["cylO"]
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


def test_the_worst_images_are_named_with_their_figure(document, printed, scores):
    for one in scores:
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


# --- a row an image ---


def test_the_csv_gives_back_every_images_figures(scores):
    text = report.per_image_csv(scores)
    assert "nan" not in text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == sum(IMAGES.values())
    of_object = {name: [row for row in rows if row["object"] == name] for name in IMAGES}
    for one in scores:
        mine = of_object[one.truth.object]
        assert [int(row["image_index"]) for row in mine] == list(range(len(one.truth)))
        assert {row["split"] for row in mine} == {"test"}
        assert [int(row["set_size"]) for row in mine] == one.truth.set_sizes.tolist()
        for stratum in ("shown", "hidden"):
            assert np.array_equal([row["stratum"] == stratum for row in mine], one.truth.strata[stratum])
        assert np.array_equal([row["barely"] == "1" for row in mine], one.truth.strata["barely"])
        for track, found in one.tracks.items():
            for metric, values in found.per_image.values.items():
                read = [float(row[f"{track}.{metric}"] or "nan") for row in mine]
                assert np.allclose(read, values, rtol=1e-11, atol=0, equal_nan=True)


def test_the_csv_leaves_empty_what_an_object_does_not_have(scores):
    rows = list(csv.DictReader(io.StringIO(report.per_image_csv(scores))))
    continuous = {row["object"]: row["hypotheses.precision_mean_error_continuous_rad"] for row in rows}
    assert continuous["tetX"] == ""
    assert float(continuous["cylO"]) >= 0
