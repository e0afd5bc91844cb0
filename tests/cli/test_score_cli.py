"""Scoring from outside: what the commands print and write, and how they end."""

import contextlib
import csv
import fcntl
import gzip
import json
import os
import pty
import re
import struct
import subprocess
import termios
from functools import partial

import h5py
import numpy as np
import symsol_annot_cli.reference
from score_commands import COMMAND, IMAGES, symsol

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.scoring.reference import ROWS, score_row
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.reports.scores_file import read_scores
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid, grid_sha256


def test_score_prints_tables_and_writes_json_and_csv_and_nothing_else(preds, data, tmp_path, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    done = symsol(
        "score", preds["tetX"], "--data", data, "--json", "scores.json", "--per-image", "images.csv", cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")  # where there is no terminal there is no bar
    scores = [score_file(preds["tetX"], data)]
    document = report.to_document(scores)
    assert done.stdout == tables.tables(document) + "\n"
    assert (tmp_path / "scores.json").read_text() == report.to_json(document)
    assert (tmp_path / "images.csv").read_text() == report.per_image_csv(scores)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["images.csv", "scores.json"]


def test_score_finds_the_sets_under_data_unless_told_otherwise(preds, data, sets, here, monkeypatch):
    monkeypatch.chdir(data.parent)
    found = [here("score", preds["cylO"], *words) for words in ([], ["--data", data], ["--data", sets["cylO"].folder])]
    for done in found:
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout == found[0].stdout
    assert found[0].stdout.startswith("cylO, test split, 4 images: mine")


def test_several_files_give_the_benchmarks_table(preds, data, here, tmp_path):
    done = here(
        "score", *preds.values(), "--data", data, "--json", tmp_path / "s.json", "--per-image", tmp_path / "i.csv"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "all objects, all images\n\nhypotheses " in done.stdout
    assert list(json.loads((tmp_path / "s.json").read_text())["objects"]) == ["tetX", "cylO"]
    with (tmp_path / "i.csv").open() as file:
        assert [row["object"] for row in csv.DictReader(file)] == ["tetX"] * 24 + ["cylO"] * 4


def test_scores_are_packed_and_rounded_where_asked(preds, data, here, tmp_path):
    packed = tmp_path / "s.json.gz"
    done = here("score", preds["tetX"], "--data", data, "--json", packed, "--decimals", "5")
    assert (done.returncode, done.stderr) == (0, "")
    document = report.to_document([score_file(preds["tetX"], data)], 5)
    assert gzip.decompress(packed.read_bytes()).decode() == report.to_json(document)
    for words, said in ((["--decimals", "5"], "goes with --json"), (["--json", packed, "--decimals", "4"], "5<=x<=12")):
        refused = here("score", preds["tetX"], "--data", data, *words)
        assert refused.returncode == 2
        assert said in refused.stderr


def test_validate_says_what_a_good_file_holds(preds, data, here):
    done = here("validate", *preds.values(), "--data", data)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        f"{preds['tetX']}: valid; tetX, 24 images: hypotheses, classifier, density",
        f"{preds['cylO']}: valid; cylO, 4 images: hypotheses",
    ]


def test_compare_puts_scores_side_by_side(preds, data, here, tmp_path):
    here("score", preds["tetX"], "--data", data, "--json", tmp_path / "a.json")
    done = here("compare", tmp_path / "a.json", tmp_path / "a.json")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("tetX, hypotheses; differences from mine: hypotheses (M = 1)")
    assert done.stdout.count("+0.0000 [+0.0000, +0.0000]") > 10


def test_predictions_written_from_the_query_file_alone_score_as_those_of_the_writer(preds, sets, data, here, tmp_path):
    """As who uses another language does: HDF5 in, HDF5 out."""
    done = here("queries", sets["tetX"].folder, "--level", "0", "--out", tmp_path / "queries.h5")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tmp_path / 'queries.h5'}\n", "")
    with h5py.File(tmp_path / "queries.h5") as asked, h5py.File(tmp_path / "preds.h5", "w") as answered:
        answered.attrs.update(dict(asked.attrs))
        answered.attrs.update({"format": "symsol-annot predictions", "method": "mine", "floor": 0.1})
        answered["image_index"] = np.arange(len(asked["query_rotation"]))
        answered["query_probability"] = (asked["query_rotation"][:, :, 0, 0] > 0.5).astype("f4")
        (claimed,) = np.nonzero(asked["grid_rotation"][:, 0, 0] > 0.5)
        answered["grid_offsets"] = np.arange(IMAGES["tetX"] + 1) * len(claimed)
        answered["grid_indices"] = np.tile(claimed, IMAGES["tetX"])
        answered["grid_probabilities"] = np.ones(IMAGES["tetX"] * len(claimed))
    done = here("score", tmp_path / "preds.h5", "--data", data, "--json", tmp_path / "s.json")
    assert (done.returncode, done.stderr) == (0, "")
    mine = json.loads((tmp_path / "s.json").read_text())["objects"]["tetX"]["classifier"]
    theirs = score_file(preds["tetX"], data)
    assert mine == report.to_document([theirs])["objects"]["tetX"]["classifier"]


def test_queries_writes_what_the_library_asks(sets, here, tmp_path):
    dataset = sets["cylO"]
    here("queries", dataset.folder, "--level", "1", "--out", tmp_path / "queries.h5")
    queries, rotation = Queries(dataset.fingerprint, dataset.symmetry_group), dataset.labels().rotation
    with h5py.File(tmp_path / "queries.h5") as file:
        for i in range(len(dataset)):
            assert np.abs(file["query_rotation"][i] - queries.rotations(i, rotation[i])).max() < 1e-7
        assert np.abs(file["grid_rotation"][...] - equivolumetric_grid(1)).max() < 1e-7
        assert dict(file.attrs) == {
            "format": "symsol-annot queries",
            "format_version": 1,
            "object": "cylO",
            "split": "test",
            "fingerprint": dataset.fingerprint,
            "group_sha256": file.attrs["group_sha256"],
            "grid_level": 1,
            "grid_sha256": grid_sha256(1),
        }


def test_reference_writes_scores_of_every_row(sets, here, tmp_path, monkeypatch):
    assert symsol_annot_cli.reference.ROWS is ROWS
    monkeypatch.setattr(symsol_annot_cli.reference, "ROWS", {row: ROWS[row] for row in ("truth", "uniform")})
    monkeypatch.setattr(symsol_annot_cli.reference, "score_row", partial(score_row, level=0))
    done = here("reference", sets["tetX"].folder, "--out", tmp_path / "a" / "reference")
    assert (done.returncode, done.stderr) == (0, "")
    written = sorted((tmp_path / "a" / "reference").iterdir())
    assert [path.name for path in written] == ["truth.json", "uniform.json"]
    assert done.stdout.count("tetX, test split, 24 images: ") == 2
    packed = here("reference", sets["tetX"].folder, "--out", tmp_path, "--row", "truth", "--gzip", "--decimals", "5")
    assert (packed.returncode, packed.stderr) == (0, "")
    assert read_scores(tmp_path / "truth.json.gz")["objects"]["tetX"]["per_image"]["decimals"] == 5
    compared = here("compare", *written)
    assert (compared.returncode, compared.stderr) == (0, "")
    assert compared.stdout.startswith("tetX, hypotheses; differences from truth: hypotheses (M = 9)")


def test_a_terminal_sees_a_bar_with_the_files_name(preds, data):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    command = [*COMMAND, "score", str(preds["tetX"]), "--data", str(data)]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # Linux's end of a terminal that nobody holds any more
            while chunk := os.read(ours, 4096):
                shown += chunk
        os.close(ours)
        process.communicate()
    assert process.returncode == 0
    assert re.search(rb"tetX\.h5: 100%\|.*\| 72/72 \[\d\d:\d\d<\d\d:\d\d, +[\d.]+row/s\]", shown)


def test_info_prints_the_fingerprint_that_predictions_of_each_split_carry(sets, preds, here):
    done = here("info", sets["tetX"].folder)
    with h5py.File(preds["tetX"]) as f:
        assert f"  fingerprint {f.attrs['fingerprint']}" in done.stdout.splitlines()
    assert "of the whole set, to name it by; predictions carry that of their split" in done.stdout
