"""Recipes that make no sense, and files that are none, are refused in full."""

import os
import time
from pathlib import Path

import pytest
from recipe_texts import GOOD, changed, refusal
from tiny_training import NARROW

from symsol_annot.bench.models.recipe import load_recipe, parse_recipe
from symsol_annot.errors import SettingsError


def test_a_name_that_is_none_is_refused_with_those_that_are():
    with pytest.raises(SettingsError, match=r"no such file, and no built-in recipe.*small-wta"):
        load_recipe("smal-wta")


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"learning_rate": 1}, "learning_rate: is no key of a hypotheses recipe; keys are title, epochs, batch_size"),
        ({"input_size": 4}, "input_size: expected 0, or 8 to 4096, found 4"),
        ({"input_size": 16, "precision": '"bfloat16"'}, "precision: bfloat16 takes an input of 17 pixels or more"),
        ({"precision": '"half"'}, "precision: expected one of auto, bfloat16, float32, found 'half'"),
        ({"schedule": '"cosine"'}, "milestones: a cosine has none, found"),
        ({"warm_up": 1e3}, "warm_up: expected 0.0 to"),
        ({"clip_norm": -1.0}, "clip_norm: expected 0.0 to"),
        ({"rolls": 1}, "rolls: expected true or false, found 1"),
        ({"statistics_images": -1}, "statistics_images: expected 0 to 65536, found -1"),
        ({"negatives": 8}, "negatives: is no key of a hypotheses recipe"),
        ({"batch_size": None}, "batch_size: is missing"),
        (
            {"model": '"mlp"'},
            "model: expected hypotheses or classifier or mixture or implicit-pdf or diffusion, found 'mlp'",
        ),
        ({"meta_loss": '"awta"'}, "meta_loss: expected one of wta, rwta, ewta, found 'awta'"),
        ({"backbone": '"resnet19"'}, "backbone: expected one of resnet18, narrow-resnet18, found 'resnet19'"),
        ({"backbone": 18}, "backbone: expected one of resnet18, narrow-resnet18, found 18"),
        (
            {"backbone": f'"{NARROW.name}"', "start": '"imagenet"'},
            "start: expected one of random for the backbone narrow-resnet18, found imagenet",
        ),
        ({"meta_loss": "3"}, "meta_loss: expected one of wta, rwta, ewta, found 3"),
        ({"epochs_to_one": 10}, "k would never be 1"),
        ({"epochs_to_one": None}, "k would never be 1"),
        ({"meta_loss": '"wta"'}, "epochs_to_one: belongs to the meta loss ewta, found wta"),
        ({"learning_rates": "[1e-3]"}, "learning_rates: expected one more than milestones, which are 1, found 1"),
        ({"learning_rates": "[1e-3, -1e-4]"}, "learning_rates: expected numbers above 0"),
        ({"learning_rates": "[nan, 1e-4]"}, "learning_rates: expected numbers above 0"),
        ({"learning_rates": "1e-3"}, "learning_rates: expected a list of numbers, found 0.001"),
        ({"learning_rates": "[1e-3, true]"}, "learning_rates: expected a number, found True"),
        ({"milestones": "[10]"}, "milestones: expected epochs from 1 to 9, found [10]"),
        ({"milestones": "[5, 5]", "learning_rates": "[1, 1, 1]"}, "milestones: expected ascending epochs"),
        ({"epochs": 2.5}, "epochs: expected a whole number, found 2.5"),
        ({"epochs": "true"}, "epochs: expected a whole number, found True"),
        ({"batch_size": 1}, "batch_size: expected 2 to 65536, found 1"),
        ({"hypotheses": 0}, "hypotheses: expected 1 to 10000, found 0"),
        ({"concentration": 0}, "concentration: expected a number above 0"),
        ({"concentration_at_first": 1.0}, "expected both or neither"),
        ({"title": 3}, "title: expected text, found 3"),
    ],
)
def test_a_recipe_that_makes_no_sense_is_refused(keys, said):
    assert said in refusal(changed(GOOD, **keys))


def test_all_faults_are_told_at_once_with_the_table_they_are_in():
    message = refusal(f"{changed(GOOD, batch_size=0, hypotheses=0)}\n[marked]\nepochs = 3\n[objects.cube]\nepoch = 3\n")
    assert "batch_size: expected" in message
    assert "hypotheses: expected" in message
    assert "[marked]: epochs_to_one: expected 0 to 2" in message
    assert "[objects.cube]: epoch: is no key" in message


@pytest.mark.parametrize(
    "text",
    ["title = ", "marked = 3", "[objects]\ncube = 1", f"title = {'[' * 9999}", f"epochs = {'9' * 9999}"],
    ids=range(5),
)
def test_what_is_no_recipe_is_refused(text):
    assert "is no TOML" in refusal(text) or "expected a table of keys" in refusal(text)


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    for path in (tmp_path, tmp_path / "binary.toml"):
        with pytest.raises(SettingsError, match="the recipe cannot be read"):
            load_recipe(str(path))


@pytest.mark.parametrize(
    ("put", "said"),
    [
        (os.mkfifo, "cannot be read: is no regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "cannot be read: is no regular file"),
        (Path.mkdir, "cannot be read: is a folder"),
        (lambda path: path.symlink_to("nowhere"), "there is no such file"),
        (lambda path: path.touch() or os.truncate(path, 2**33), "is larger than the 65,536 bytes"),
        (lambda path: path.write_bytes(b"#" * 2**16 + b"\n"), "is larger than the 65,536 bytes"),
    ],
    ids=["a FIFO", "a device", "a folder", "a link to nowhere", "8 GB", "64 KiB and one"],
)
def test_what_is_no_small_file_is_refused_without_waiting(tmp_path, put, said):
    put(tmp_path / "mine.toml")
    with pytest.raises(SettingsError, match=said):
        load_recipe(str(tmp_path / "mine.toml"))


@pytest.mark.parametrize("name", ["\x1b[2J.toml", "two\nlines.toml", " .toml", ".toml", "x" * 201 + ".toml"])
def test_a_recipe_is_called_by_its_file_which_has_a_methods_name(tmp_path, name):
    (tmp_path / name).write_text(GOOD)
    with pytest.raises(
        SettingsError, match="1 to 200 printable characters, not all of them spaces; rename it"
    ) as caught:
        load_recipe(str(tmp_path / name))
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize("name", ["", "a\0b", "x" * 300, "x" * 5000])
def test_a_name_that_can_be_no_path_is_refused(name):
    with pytest.raises(SettingsError):
        load_recipe(name)


def test_a_byte_order_mark_and_windows_line_ends_change_nothing(tmp_path):
    (tmp_path / "mine.toml").write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_recipe(str(tmp_path / "mine.toml")).base == parse_recipe(GOOD, "mine.toml").base


STRANGE = {
    "a title of many lines": (changed(GOOD, title=r'"a\nb"'), "title: expected 1 to 200 printable characters"),
    "a title of escapes": (changed(GOOD, title=r'"\u001b[2J"'), "title: expected 1 to 200 printable characters"),
    "a title without end": (changed(GOOD, title=f'"{"x" * 60_000}"'), "title: expected 1 to 200 printable characters"),
    "a title of nothing": (changed(GOOD, title='""'), "title: expected 1 to 200 printable characters"),
    "10^9 hypotheses": (changed(GOOD, hypotheses=10**9), "hypotheses: expected 1 to 10000, found 1000000000"),
    "2^63 epochs": (changed(GOOD, epochs=2**63 - 1), "epochs: expected 1 to 10000, found 9223372036854775807"),
    "2^63 validation images": (changed(GOOD, validation_images=2**63 - 1), "validation_images: expected 0 to 10000000"),
    "a huge concentration": (changed(GOOD, concentration="1e308"), "concentration: expected a number above 0, up to"),
    "an infinite rate": (changed(GOOD, learning_rates="[inf, 1]"), "learning_rates: expected numbers above 0"),
    "a thousand rates": (
        changed(GOOD, learning_rates=[1] * 1000),
        "learning_rates: expected at most 64, found 1000",
    ),
    "an object that is a path": (f"{GOOD}[objects.'../cube']\nepochs = 3", "objects: expected an object's name"),
    "an object with a line end": (f'{GOOD}[objects."a\\nb"]\nepochs = 3', "objects: expected an object's name"),
    "a thousand objects": (f"{GOOD}[objects]\n" + "".join(f"a{i} = {{}}\n" for i in range(1000)), "at most 256"),
    "thousands of keys": (GOOD + "".join(f"k{i} = 1\n" for i in range(5000)), "at most 64 keys, found 5011"),
    "thousands of keys of an object": (
        f"{GOOD}[objects.a]\n" + "".join(f"k{i} = 1\n" for i in range(5000)),
        "at most 64",
    ),
    "tables for values": (changed(GOOD, epochs="{ a = 1 }", title="[[1]]"), "expected"),
    "a model that is a table": (changed(GOOD, model="{ a = 1 }"), "model: expected hypotheses or classifier"),
    "hexadecimal digits": (changed(GOOD, epochs=f"0x{'f' * 60_000}"), "is no TOML: it holds an integer beyond 64 bits"),
    "in a list": (changed(GOOD, milestones=f"[0x{'f' * 60_000}]"), "is no TOML: it holds an integer beyond 64 bits"),
    "nested tables": (GOOD + "a = " + "{a=" * 15_000, "is no TOML: it is nested too deep"),
    "a key of 30,000 parts": (GOOD + ".".join("a" * 30_000) + " = 1", "is no TOML: more than 256 dots in a line"),
}


@pytest.mark.parametrize(("text", "said"), STRANGE.values(), ids=STRANGE)
def test_what_no_training_has_a_use_for_is_one_short_refusal_in_time(text, said):
    start = time.process_time()
    message = refusal(text)
    assert time.process_time() - start < 10.0
    assert said in message
    assert len(message) < 4000
