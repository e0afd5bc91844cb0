"""Scores as a document, and as a row per image."""

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
from hypothesis import given, settings
from hypothesis import strategies as st
from reported_scores import IMAGES, LEVEL, METHOD

from symsol_annot import __version__
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import grid_sha256


@pytest.fixture(scope="module")
def document(reported):
    return reported.document


@pytest.fixture(scope="module")
def scores(reported):
    return reported.scores


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


def test_the_document_says_what_it_is_about_and_with_what_it_was_made(document, reported):
    assert (document["format"], document["format_version"]) == ("symsol-annot scores", 1)
    assert document["method"] == METHOD
    assert document["versions"] == {
        "symsol-annot": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "h5py": h5py.__version__,
    }
    assert document["bootstrap"] == {"draws": 2000, "interval": 0.95, "min_images": 20}
    for path, (name, dataset) in zip(reported.paths, reported.sets.items(), strict=True):
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


def test_two_files_about_one_object_are_refused(scores):
    with pytest.raises(ScoresError, match="more than one of the files is about tetX; score one file per object"):
        report.to_document([scores[0], scores[1], scores[0]])


def test_files_of_two_methods_are_refused(scores, reported, tmp_path):
    other = tmp_path / "other.h5"
    write_hypotheses(other, reported.sets["cylO"], lambda i: np.eye(3)[None], method="another")
    with pytest.raises(ScoresError, match=r"the files are of different methods \(a  method .*, another\)"):
        report.to_document([scores[0], score_file(other, reported.sets["cylO"].folder)])


# --- a row per image ---


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
