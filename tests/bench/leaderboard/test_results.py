"""The leaderboard shows what the files of results say, and refuses files that nobody could check."""

import json
import os
import re
import shutil
from pathlib import Path

import pytest
from made_boards import IMAGES, change_of, edited

from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reports.scores_file import figures_that_differ
from symsol_annot.bench.scoring.scorers.table import metrics_shown
from symsol_annot.errors import ScoresError


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 100_000, "cannot be read"),
        ("x = 1\n" * 60_000, "larger than"),
        ("\n".join(f"k{i} = 1" for i in range(5_000)), " faults more"),
        ("title = " + json.dumps("x" * 30_000) + "\ndate = " + json.dumps("y" * 30_000), "date: expected a date"),
        ('"\\u001b[2J" = 1', r"'\x1b[2J': is no key of a result"),
        ("\x00", "cannot be read"),
    ],
)
def test_a_hostile_toml_ends_in_a_short_message(text, said, folder):
    (folder / "tiny" / "far.toml").write_text(text)
    with pytest.raises(ScoresError) as refused:
        read_leaderboard(folder)
    assert said in str(refused.value)
    assert len(str(refused.value)) < 10_000
    assert all(line.isprintable() for line in str(refused.value).splitlines())


def test_what_an_operating_system_leaves_in_folders_is_passed_over(folder):
    (folder / ".git").mkdir()
    (folder / "tiny" / "._far.toml").write_bytes(b"\x00")
    (folder / "tiny" / ".DS_Store").write_bytes(b"\x00")
    assert set(read_leaderboard(str(folder)).sets) == {"tiny"}


@pytest.mark.parametrize("name", ["a|b", "[x](http:evil)", "<b>", "a b", "é", "a\nb", "`"])
def test_names_that_would_be_more_than_text_on_the_page_are_refused(name, folder):
    place, new = folder / "tiny", name.replace("/", "")
    for ending in ("toml", "json"):
        (place / f"far.{ending}").rename(place / f"{new}.{ending}")
    place.rename(folder / f"set{new}")
    with pytest.raises(ScoresError, match=r"the leaderboard has 2 faults") as refused:
        read_leaderboard(folder)
    for unfit in (f"set{new}", new):
        assert f": {unfit!r}: a name has letters, digits, '.', '_' and '-' alone" in str(refused.value)


@pytest.mark.parametrize("file", ["set.toml", "far.toml", "far.json"])
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(file, folder):
    path = folder / "tiny" / file
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ScoresError, match=rf"{file}: .*regular file"):
        read_leaderboard(folder)


def without_figures(track, metric):
    """Leave a metric out of all that an object's scores say."""

    def change(place):
        document = json.loads((place / "far.json").read_text())
        entry = document["objects"]["tetX"]
        for table in (*(entry[track][s] for s in ("all", *entry["per_image"]["strata"])), entry["per_image"][track]):
            del table[metric]
        (place / "far.json").write_text(json.dumps(document))

    return change


@pytest.mark.parametrize("track", ["hypotheses", "classifier"])
def test_no_figure_of_the_page_can_be_left_out(track, folder):
    for metric in metrics_shown(track, Place.LEADERBOARD):
        board = Path(shutil.copytree(folder, folder.parent / metric.name))
        without_figures(track, metric.name)(board / "tiny")
        with pytest.raises(ScoresError, match=rf"has 1 fault:\n.*per_image\.{track}\.{metric.name}: is missing"):
            read_leaderboard(board)


def scores_with(*keys, value):
    return lambda place: edited(place / "far.json", *keys, value=value)


RECALL = ("objects", "tetX", "hypotheses", "all", "recall_mean_error_rad")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (scores_with(*RECALL, "value", value=0.001), "all.recall_mean_error_rad.value: says 0.001, its images give"),
        (scores_with(*RECALL, "low", value=None), "all.recall_mean_error_rad.low: says None, its images give"),
        (
            scores_with("objects", "tetX", "hypotheses", "shown", "accuracy_at_5_deg", "value", value=1),
            "shown.accuracy",
        ),
        (scores_with("ranks", value=False), "'ranks' is not true"),
        (
            scores_with("objects", "tetX", "classifier", "warnings", value=["w"]),
            "tetX.classifier.warnings: does not rank",
        ),
        (scores_with("objects", "tetX", "fingerprint", value="0" * 64), "fingerprint: expected"),
        (scores_with("objects", "tetX", "split", value="train"), "split: expected test, found 'train'"),
        (scores_with("objects", "tetX", "predictions", value={"sha256": "?"}), "predictions.sha256: is no SHA-256"),
        (scores_with("format", value="x"), "is no scores file"),
        (lambda place: (place / "far.json").unlink(), "far.json: cannot be read"),
        (lambda place: (place / "far.toml").unlink(), "far.toml: cannot be read"),
        (lambda place: (place / "set.toml").unlink(), "set.toml: cannot be read"),
        (lambda place: (place / "far.json").write_text("{"), "is no JSON"),
        (lambda place: shutil.copy(place / "near.json", place / "far.json"), "are those of tiny/far"),
        (change_of("far.toml", "seed = 7", ""), "far.toml: objects.tetX.seed: is missing"),
        (change_of("far.toml", "seed = 7", "seed = 7.5"), "objects.tetX.seed: expected a whole number, found 7.5"),
        (
            change_of("far.toml", "objects.tetX", "objects.cube"),
            "objects: expected those of the scores, tetX, found cube",
        ),
        (change_of("far.toml", "2026-01-02", '"today"'), "date: expected a date, found 'today'"),
        (change_of("far.toml", '"./far.sh"', ""), "commands, code: one of them has to say"),
        (
            change_of("far.toml", 'commands = ["./far.sh"]', 'code = "see our paper"'),
            "code: expected an address that begins with https://, found 'see our paper'",
        ),
        (
            change_of("far.toml", '"./far.sh"]', '"./far.sh"]\ncode = "https://e.org/)[x](javascript:1)"'),
            "code: expected an address",
        ),
        (
            change_of("far.toml", "recipe =", "input_px = 0\nrecipe ="),
            "input_px: expected 1 to 16384 pixels, found 0",
        ),
        (change_of("far.toml", "recipe =", "given_group = 1\nrecipe ="), "given_group: expected"),
        (change_of("far.toml", '"small-wta"', '"mine"'), "recipe: there is no 'mine' built in"),
        (change_of("far.toml", '"a lab"', '" "'), "by: is empty"),
        (change_of("far.toml", "by =", "from ="), "from: is no key of a result; keys are title, by"),
        (change_of("far.toml", "by =", "by"), "far.toml: cannot be read"),
        (change_of("far.toml", '"a lab"', 5000 * "[" + 5000 * "]"), "far.toml: cannot be read: "),
        (change_of("far.toml", "seed = 7", "seed = -3"), "objects.tetX.seed: expected 0 or more, found -3"),
        (
            change_of("far.toml", "seed = 7", f"seed = 0x{5000 * 'f'}"),
            "far.toml: cannot be read: it holds an integer beyond 64 bits",
        ),
        (change_of("far.toml", "seed = 7", f"seed = {5000 * '9'}"), "far.toml: cannot be read: "),
        (change_of("far.toml", "3.25", "nan"), "objects.tetX.minutes: expected a finite number, 0 or more, found nan"),
        (change_of("far.toml", "3.25", "-1"), "objects.tetX.minutes: expected a finite number, 0 or more, found -1.0"),
        (
            change_of("far.toml", "3.25", "1\nprocessor_minutes = inf"),
            "objects.tetX.processor_minutes: expected a finite number, 0 or more, found inf",
        ),
        (change_of("set.toml", f"images = {IMAGES}", "images = 0"), "set.toml: images: expected 1 or more, found 0"),
        (change_of("set.toml", '"test"', '"<b>"'), "set.toml: split: expected one of train, test, found '<b>'"),
        (change_of("set.toml", "tetX =", "'<b>' ="), "set.toml: fingerprints: '<b>': an object's name has"),
        (scores_with(*RECALL, value={"value": 0.1}), "all.recall_mean_error_rad has no value with an interval"),
        (scores_with("objects", "tetX", "per_image", "strata", value={"all": [0]}), "strata has others than shown"),
        (change_of("set.toml", f"images = {IMAGES}", "images = 1"), f"images: expected 1, found {IMAGES}"),
        (change_of("set.toml", "tetX =", "cube ="), "fingerprint: expected None"),
    ],
)
def test_files_that_nobody_could_check_are_refused(change, said, folder):
    change(folder / "tiny")
    with pytest.raises(ScoresError, match=re.escape(said)):
        read_leaderboard(folder)


def test_all_faults_are_told_at_once(folder):
    (folder / "tiny" / "far.toml").unlink()
    edited(folder / "tiny" / "near.json", "ranks", value=False)
    with pytest.raises(ScoresError, match=r"the leaderboard has 2 faults:\n(.*\n)*.*'ranks' is not true"):
        read_leaderboard(folder)


def test_no_figure_differs_in_what_score_wrote(folder):
    for name in ("near", "far"):
        document = json.loads((folder / "tiny" / f"{name}.json").read_text())
        assert list(figures_that_differ(document["objects"]["tetX"])) == []


def test_a_folder_without_the_thesis_is_no_leaderboard(tmp_path):
    with pytest.raises(ScoresError, match=r"is no leaderboard's folder: it has no thesis\.toml"):
        read_leaderboard(tmp_path)
