"""Scoring from outside: real processes, what they print, how they end, what they import."""

import contextlib
import csv
import fcntl
import json
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import symsol_annot_cli.reference
from bench_sets import SUPPORT, run, small_set

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring import report
from symsol_annot.bench.scoring.reference import ROWS, score_row
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid, grid_sha256

CALL_MAIN = "from symsol_annot_cli.main import main; main()"
COMMAND = (sys.executable, "-c", CALL_MAIN)
IMAGES = {"tetX": 24, "cylO": 4}


def symsol(*arguments, **options):
    return run(*COMMAND, *arguments, **options)


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    folder = tmp_path_factory.mktemp("place") / "data"
    return {name: small_set(folder, name, images) for name, images in IMAGES.items()}


@pytest.fixture(scope="module")
def data(sets):
    return sets["tetX"].folder.parent


@pytest.fixture(scope="module")
def preds(sets, tmp_path_factory):
    """A file an object; the one of tetX has every track."""
    folder = tmp_path_factory.mktemp("preds")
    for name, dataset in sets.items():
        rotation = dataset.labels().rotation
        write_hypotheses(folder / f"{name}.h5", dataset, rotation[:, None], method="mine")
    options = {"method": "mine", "level": 0}
    write_classifier(folder / "tetX.h5", sets["tetX"], lambda i, R: R[:, 0, 0] > 0.5, **options)
    write_density(folder / "tetX.h5", sets["tetX"], lambda i, R: 3.0 * R[:, 0, 0], **options)
    return {name: folder / f"{name}.h5" for name in sets}


# --- a command that does its work ---


def test_score_prints_tables_and_writes_json_and_csv_and_nothing_else(preds, data, tmp_path):
    done = symsol(
        "score", preds["tetX"], "--data", data, "--json", "scores.json", "--per-image", "images.csv", cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")  # where there is no terminal there is no bar
    scores = [score_file(preds["tetX"], data)]
    document = report.to_document(scores)
    assert done.stdout == report.tables(document) + "\n"
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


# --- input that is wrong: exit code 1 and a message ---


def assert_refused(done, *words, code=1):
    assert done.returncode == code
    for word in words:
        assert re.search(word, done.stderr), done.stderr


@pytest.mark.parametrize("command", ["score", "validate"])
def test_a_missing_set_is_named(preds, data, here, tmp_path, command):
    nowhere = here(command, preds["tetX"], "--data", tmp_path)
    assert_refused(
        nowhere, rf"^Error: {tmp_path}: holds no set of the object 'tetX': there is no set in it; --data names .*\n$"
    )
    assert_refused(here(command, preds["tetX"], "--data", tmp_path / "missing"), "holds no set of the object 'tetX'")
    assert nowhere.stdout == ""


def test_a_set_of_another_object_or_another_set_of_the_same_is_named(preds, sets, here, tmp_path):
    done = here("score", preds["tetX"], "--data", sets["cylO"].folder)
    assert_refused(done, "attribute 'object': expected 'cylO', found 'tetX'; --data names a set of another object")
    small_set(tmp_path, "tetX", 24, seed=7)
    done = here("validate", preds["tetX"], "--data", tmp_path)
    assert_refused(
        done, "attribute 'fingerprint': expected .* the file is about another data set, or another version of it"
    )


def test_a_damaged_set_is_named(preds, data, here, tmp_path):
    folder = Path(shutil.copytree(data / "cylO", tmp_path / "cylO"))
    (shard,) = folder.glob("*.h5")
    shard.write_bytes(shard.read_bytes()[:1000])
    assert_refused(here("validate", preds["cylO"], "--data", tmp_path), rf"^Error: .*{shard.name}")
    shard.unlink()
    assert_refused(here("score", preds["cylO"], "--data", tmp_path), "1 of 1 test shards are missing")


@pytest.mark.parametrize("command", ["score", "validate"])
def test_what_is_no_predictions_file_is_named(sets, data, here, tmp_path, command):
    (tmp_path / "text.h5").write_text("mine")
    (shard,) = sets["cylO"].folder.glob("*.h5")
    for path, words in (
        (tmp_path / "missing.h5", "there is no such file"),
        (tmp_path, "is no regular file"),
        (tmp_path / "text.h5", "cannot be read as HDF5"),
        (shard, "attribute 'format': expected 'symsol-annot predictions'"),
    ):
        done = here(command, path, "--data", data)
        assert_refused(done, rf"^Error: {path}: 1 fault; docs/submission.md says what belongs there:\n  - .*{words}")
        assert done.stdout == ""


@pytest.fixture
def broken(preds, tmp_path):
    """A file with seven faults."""
    path = Path(shutil.copy(preds["tetX"], tmp_path / "broken.h5"))
    with h5py.File(path, "r+") as file:
        file.attrs["split"] = "test"
        file.attrs["group_sha256"] = "0" * 64
        file["hypotheses"][3, 0, 1, 1] = np.nan
        file["hypotheses"][[5, 6], 0] *= -1
        file["query_probability"][7, 8] = 1.5
        file["density_log_probabilities"][0] = 0.25
        file["density_indices"][1] = file["density_indices"][0]
        file["notes"] = np.arange(3)
    return path


FAULTS = (
    r"  - the file: 'notes' is not part of the format\n",
    r"  - classifier: attribute 'group_sha256': expected '[0-9a-f]{64}', found '0{64}'; the queries were asked in",
    r"  - hypotheses: 'hypotheses' has a NaN or an infinite entry: row 3\n",
    r"  - hypotheses: 'hypotheses' holds a matrix that is no rotation .*: rows 5 \(.*with determinant -1\), 6 \(",
    r"  - density: 'density_log_probabilities' are not in \[-1e\+06, 0\]; .*: row 0\n",
    r"  - density: 'density_indices' are not ascending, or one is repeated: row 0\n",
)


@pytest.mark.parametrize("command", ["score", "validate"])
def test_all_faults_of_a_broken_file_are_listed_at_once(broken, data, here, command):
    done = (symsol if command == "validate" else here)(command, broken, "--data", data)
    assert_refused(done, rf"^Error: {broken}: 6 faults; docs/submission.md says", *FAULTS)
    assert done.stderr.count("\n  - ") == len(FAULTS)
    assert done.stdout == ""


def test_validate_goes_on_after_a_broken_file(broken, preds, data, here):
    done = here("validate", broken, preds["cylO"], broken, "--data", data)
    assert done.returncode == 1
    assert done.stderr.count(f"Error: {broken}: 6 faults") == 2
    assert done.stdout == f"{preds['cylO']}: valid; cylO, 4 images: hypotheses\n"


def test_files_that_make_no_table_together_are_refused(preds, sets, data, here, tmp_path):
    assert_refused(
        here("score", preds["cylO"], preds["cylO"], "--data", data), "^Error: more than one of the files is about cylO"
    )
    write_hypotheses(tmp_path / "other.h5", sets["cylO"], lambda i: np.eye(3)[None], method="theirs")
    done = here("score", preds["tetX"], tmp_path / "other.h5", "--data", data)
    assert_refused(done, r"^Error: the files are of different methods \(mine, theirs\)")


@pytest.mark.parametrize("option", ["--json", "--per-image"])
def test_a_path_that_cannot_be_written_is_an_error_after_the_table(preds, data, here, tmp_path, option):
    (tmp_path / "file").write_text("mine")
    done = here("score", preds["cylO"], "--data", data, option, tmp_path / "file" / "out")
    assert_refused(done, rf"^Error: {tmp_path}/file/out: cannot be written: a part of the path is a file")
    assert done.stdout.startswith("cylO, test split, 4 images")
    done = here("score", preds["cylO"], "--data", data, option, tmp_path / "missing" / "out")
    assert_refused(done, rf"^Error: {tmp_path}/missing/out: cannot be written: No such file or directory")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_scores_that_cannot_be_compared_are_named(here, tmp_path):
    (tmp_path / "a.json").write_text("{}")
    assert_refused(
        here("compare", tmp_path / "a.json", tmp_path / "a.json"), rf"^Error: {tmp_path}/a.json: is no scores file"
    )
    assert_refused(
        here("compare", tmp_path / "b.json", tmp_path / "a.json"),
        rf"^Error: {tmp_path}/b.json: cannot be read: No such",
    )


def test_queries_and_reference_name_a_set_that_is_not_there_and_a_path_that_is_in_the_way(sets, here, tmp_path):
    for command in ("queries", "reference"):
        assert_refused(here(command, tmp_path, "--out", tmp_path / "out"), rf"^Error: {tmp_path}.*manifest.json")
        assert_refused(here(command, sets["cylO"].folder, "--split", "train"), "has no split 'train'; it has test")
    (tmp_path / "file").write_text("mine")
    for command in ("queries", "reference"):
        done = here(command, sets["cylO"].folder, "--out", tmp_path / "file" / "out")
        assert_refused(done, rf"^Error: {tmp_path}/file.*: cannot be written: .*is a file, not a folder")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# --- a command line that is wrong: exit code 2 ---


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["score"], "Missing argument 'PREDS.H5...'"),
        (["validate"], "Missing argument 'PREDS.H5...'"),
        (["compare"], "Missing argument 'SCORES.JSON...'"),
        (["compare", "a.json"], "compare takes two scores files or more; `score --json` writes them"),
        (["queries"], "Missing argument 'DATA'"),
        (["queries", "data", "--level", "6"], "6 is not in the range 0<=x<=5"),
        (["reference"], "Missing argument 'DATA...'"),
        (["score", "preds.h5", "--json", "/"], "is a directory"),
        (["score", "preds.h5", "--json", "preds.h5"], "--json and --per-image each need a file of their own"),
        (["score", "preds.h5", "--json", "out", "--per-image", "./out"], "each need a file of their own"),
        (["score", "preds.h5", "--jsno", "out"], "No such option"),
    ],
)
def test_a_wrong_command_line_is_refused(here, words, said):
    done = here(*words)
    assert_refused(done, re.escape(said), code=2)
    assert done.stdout == ""


# --- what is imported ---

FORBIDDEN = ("torch", "roma", "bpy")
WITH_A_GUARD = f"""
import sys

class Guard:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {FORBIDDEN}:
            raise SystemExit(f"{{name}} was imported")

sys.meta_path.insert(0, Guard)
"""
GUARDED_MAIN = f"""{WITH_A_GUARD}
import atexit
from symsol_annot_cli.main import main
try:
    main()
finally:
    print([name for name in {FORBIDDEN} if name in sys.modules], file=sys.stderr)
"""
GUARDED_WRITING = f"""{WITH_A_GUARD}
import numpy as np
import symsol_annot
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
test = symsol_annot.load(sys.argv[1])
write_hypotheses(sys.argv[2], test, lambda i: test[i].rotation[None], method="mine")
write_classifier(sys.argv[2], test, lambda i, R: np.zeros(len(R)), method="mine", level=0)
write_density(sys.argv[2], test, lambda i, R: R[:, 0, 0], method="mine", level=0)
print([name for name in {FORBIDDEN} if name in sys.modules], file=sys.stderr)
"""


@pytest.fixture
def guarded(tmp_path):
    """Runs Python where importing one of these ends the process, in whatever process; the modules are there."""
    trap = tmp_path / "trap"
    trap.mkdir()
    for name in FORBIDDEN:
        (trap / f"{name}.py").write_text(f"raise SystemExit('{name} was imported')")
    path = os.pathsep.join(filter(None, [str(trap), str(SUPPORT), os.environ.get("PYTHONPATH")]))

    def call(code, *arguments):
        return run(sys.executable, "-c", code, *arguments, env={"PYTHONPATH": path})

    return call


@pytest.mark.parametrize("name", FORBIDDEN)
def test_the_guard_sees_what_is_imported(guarded, name):
    assert guarded(f"{WITH_A_GUARD}\nimport {name}").stderr == f"{name} was imported\n"
    assert guarded(f"import {name}").stderr == f"{name} was imported\n"


def test_scoring_validating_and_comparing_import_neither_torch_nor_roma_nor_blender(preds, data, guarded, tmp_path):
    for words in (
        ["score", preds["tetX"], "--data", data, "--json", tmp_path / "s.json", "--per-image", tmp_path / "i.csv"],
        ["validate", preds["tetX"], "--data", data],
        ["compare", tmp_path / "s.json", tmp_path / "s.json"],
    ):
        done = guarded(GUARDED_MAIN, *words)
        assert (done.returncode, done.stderr) == (0, "[]\n")
        assert done.stdout != ""


def test_writing_predictions_imports_neither_torch_nor_roma_nor_blender(sets, guarded, tmp_path):
    done = guarded(GUARDED_WRITING, sets["cylO"].folder, tmp_path / "preds.h5")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "[]\n")
    with h5py.File(tmp_path / "preds.h5") as file:
        assert {"hypotheses", "query_probability", "density_offsets"} <= set(file)


def test_info_prints_the_fingerprint_that_predictions_of_each_split_carry(sets, preds, here):
    done = here("info", sets["tetX"].folder)
    with h5py.File(preds["tetX"]) as f:
        assert f"  fingerprint {f.attrs['fingerprint']}" in done.stdout.splitlines()
    assert "of the whole set, to name it by; predictions carry that of their split" in done.stdout
