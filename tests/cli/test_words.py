"""The command line in whole words: grouped help, what a mistyped word was meant for, and answers for programs."""

import json
import re

import click
import pytest
from click.testing import CliRunner
from symsol_annot_cli import main
from symsol_annot_cli.main import app

import symsol_annot
from symsol_annot.sets.manifest import read_manifest


def commands_of(group, *path):
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        yield (*path, name), command
        if isinstance(command, click.Group):
            yield from commands_of(command, *path, name)


def test_help_has_each_command_in_a_group_with_its_whole_summary():
    printed = " ".join(CliRunner().invoke(app, ["--help"]).output.split())
    for title, names in main._GROUPS.items():
        assert f"{title}: {names[0]}" in printed
    for name in app.list_commands(None):
        summary = " ".join(app.get_command(None, name).help.split("\n\n")[0].split())
        assert f"{name} {summary}" in printed
    assert "..." not in printed.replace("[ARGS]...", "")


def test_every_option_says_what_it_is_in_words():
    for path, command in commands_of(app):
        for option in (p for p in command.params if isinstance(p, click.Option) and p.name != "help"):
            words = option.help or ""
            assert re.fullmatch(r"([A-Z]|auto: ).*\.(  \[.+\])?", words), f"{path}: {option.opts}: {words!r}"


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["scroe", "preds.h5"], "did you mean 'score'?"),
        (["plot", "images", "data", "--split", "tets"], "did you mean 'test'?"),
        (["render", "--object", "cyl0"], "'cylO'? Built-in objects"),
        (["train", "smal-ewta"], "did you mean 'small-ewta'"),
        (["score", "preds.h5", "--interval"], "--intervals"),
        (["gallery", "data", "--split", "trian"], "did you mean 'train'?"),
        (["convert", "a.npz", "--order", "wxzy"], "did you mean 'wxyz'"),
    ],
)
def test_a_mistyped_word_is_answered_with_the_one_that_was_meant(here, words, meant):
    done = here(*words)
    assert done.returncode in {1, 2}
    assert meant in done.stderr


def test_info_says_the_same_to_programs(sets, here):
    folder = sets["tetX"].folder
    done = here("info", folder, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found, manifest = json.loads(done.stdout), read_manifest(folder)
    assert (found["object"], found["kind"], found["fingerprint"]) == ("tetX", "rendered", manifest.fingerprint)
    test = symsol_annot.load(folder)
    split = found["splits"]["test"]
    assert (split["images"], split["fingerprint"]) == (len(test), test.fingerprint)
    assert split["marking_shown"] == test.labels().marking_visible.sum()
    assert sum(split["set_sizes"].values()) == len(test)
    assert list(found["splits"]) == ["test"]
    assert found["image_size"] == list(test.image_size)


def test_a_picture_goes_to_the_working_folder(sets, here, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    done = here("plot", "images", sets["tetX"].folder, "--count", "1")
    assert (done.returncode, done.stdout) == (0, "tetX-test.png\n")
    assert (tmp_path / "tetX-test.png").is_file()


def test_score_fits_the_columns_that_there_are(preds, data, here, monkeypatch):
    for columns in (50, 90, 200):
        monkeypatch.setenv("COLUMNS", str(columns))
        done = here("score", preds["tetX"], "--data", data)
        assert max(map(len, done.stdout.splitlines())) <= columns
        assert " [" not in done.stdout
        assert " [" in here("score", preds["tetX"], "--data", data, "--intervals").stdout
