"""Scoring from outside: what is wrong with the input or the command line is said, and nothing else."""

import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_sets import small_set
from score_commands import symsol

from symsol_annot.bench.predictions.writing.submission import write_hypotheses

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
