"""A row's predictions give its figures again, or the command shows which differ and fails."""

import json

import pytest
from click.testing import CliRunner
from made_boards import add_result, edited, turned
from symsol_annot_cli.leaderboard import leaderboard

from symsol_annot.bench.leaderboard.rescoring import _differences, rescore
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.errors import ScoresError


@pytest.fixture(scope="module")
def predictions(images, tmp_path_factory):
    path = tmp_path_factory.mktemp("predictions") / "mine.h5"
    write_hypotheses(path, images, turned(images, 0.05), method="mine")
    return path


@pytest.fixture
def board(folder, images, predictions):
    """The folder with the predictions' row."""
    add_result(folder / "tiny", "mine", predictions, images)
    return folder


def run(board, images, predictions, *options):
    return CliRunner().invoke(
        leaderboard, [str(board), "--rescore", str(predictions), "--data", str(images.folder), *options]
    )


def test_predictions_give_the_figures_of_their_row_again(board, images, predictions):
    done = run(board, images, predictions)
    assert done.exit_code == 0
    assert "equal to tiny/mine in all" in done.output


def test_a_figure_that_differs_is_shown_with_both_values(board, images, predictions):
    """One that the images' figures do not give, so that reading the board cannot notice."""
    keys = ("objects", "tetX", "hypotheses", "all", "coverage_at_1_deg", "value")
    edited(board / "tiny" / "mine.json", *keys, value=0.875)
    value = json.loads((board / "tiny" / "mine.json").read_text())["objects"]["tetX"]["hypotheses"]["shown"]
    refused = run(board, images, predictions)
    assert refused.exit_code == 1
    assert isinstance(refused.exception, ScoresError)
    lines = str(refused.exception).splitlines()
    assert "1 of " in lines[0]
    assert lines[1] == "--- tiny/mine.json, tetX"
    assert lines[3] == "-hypotheses.all.coverage_at_1_deg.value: 0.875"
    assert lines[4].startswith("+hypotheses.all.coverage_at_1_deg.value: 0")
    assert value["coverage_at_1_deg"]["value"] is not None


def test_predictions_of_no_row_are_refused_or_compared_with_the_row_that_is_named(folder, images, predictions):
    refused = run(folder, images, predictions)
    assert "no row is of these predictions (about tetX, SHA-256" in str(refused.exception)
    assert "there are tiny/far, tiny/near" in str(refused.exception)
    found = rescore(read_leaderboard(folder), predictions, images.folder, "tiny/near")
    assert not found.is_same_file
    assert any(line.startswith("-hypotheses.all.precision_mean_error_rad.value: 0.0") for line in found.diff)
    assert any("24 of 24 differ" in line for line in found.diff)
    with pytest.raises(ScoresError, match="--row 'tiny/x': there is no such row about tetX"):
        rescore(read_leaderboard(folder), predictions, images.folder, "tiny/x")


def test_the_same_answers_in_another_file_are_equal_to_the_row_that_is_named(board, images, tmp_path):
    path = tmp_path / "again.h5"
    write_hypotheses(path, images, turned(images, 0.05), method="another name")
    assert "though it is another file" in run(board, images, path, "--row", "tiny/mine").output


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ({"a": [1.0, 2.0, 3.0]}, {"a": [1.0, 2.5, 4.0]}, ["-a[1]: 2.0", "+a[1]: 2.5  (2 of 3 differ)"]),
        ({"a": [1, 2]}, {"a": [1]}, ["-a: 2 values", "+a: 1 values"]),
        ({"a": None}, {"a": 0.0}, ["-a: None", "+a: 0.0"]),
        ({"a": None}, {"a": None}, []),
        ({"a": 1.0}, {"a": 1.0 + 1e-12}, []),
        ({"a": True}, {"a": 1}, ["-a: True", "+a: 1"]),
        ({"a": "x"}, {}, ["-a: 'x'", "+a: nothing"]),
        ({}, {"a": "x"}, ["-a: nothing", "+a: 'x'"]),
        ({"a": ["x"]}, {"a": ["y"]}, ["-a[0]: 'x'", "+a[0]: 'y'  (1 of 1 differ)"]),
    ],
)
def test_differences_are_lines_with_both_sides(old, new, said):
    assert list(_differences("a", old, new)) == said


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--out", "x.md", "--rescore", "preds.h5"],
        ["--rescore", "preds.h5", "--check"],
        ["--out", "x.md", "--row", "tiny/mine"],
    ],
)
def test_the_page_and_a_rescoring_are_two_things(options, folder):
    assert CliRunner().invoke(leaderboard, [str(folder), *options]).exit_code == 2
