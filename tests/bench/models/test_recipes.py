"""Recipes: each row of the thesis's tables has one with its settings, and what makes no sense is refused in full."""

import json
import os
import re
import subprocess
import sys
import time
import zipfile
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import pytest
from tiny_training import NARROW

from symsol_annot.bench.models.kinds import MODEL_KINDS, kind_of
from symsol_annot.bench.models.loss_tables import concentration_at, winners_at
from symsol_annot.bench.models.methods.classifier.recipe import ClassifierRecipe
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.recipe import (
    builtin_recipes,
    load_recipe,
    parse_recipe,
    recipe_from_toml,
    recipe_to_toml,
)
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.errors import SettingsError

KS = (64, 128, 512, 1024)  # of figure 7.4, beside the baseline's 256

ROOT = Path(__file__).resolve().parents[3]
UNMARKED, MARKED = ("tet", "cube", "icosa", "cone", "cyl"), ("tetX", "cylO")
HYPOTHESES = [f"{meta}-{loss}" for meta in ("wta", "rwta", "ewta") for loss in ("cosine", "von-mises")]
STARRED = ("cube", "cone", "cyl", "tetX", "cylO")  # in table 7.1: the rate is 1e-4 from epoch 4

GOOD = """
title = "a test"
model = "hypotheses"
start = "random"
hypotheses = 4
meta_loss = "ewta"
embedded_loss = "von-mises"
batch_size = 8
epochs = 10
epochs_to_one = 5
learning_rates = [1e-3, 1e-4]
milestones = [8]
"""


def recipe(name, of="tet"):
    return load_recipe(name).for_object(of, has_marking=of in MARKED)


def rates_of(recipe):
    return [recipe.learning_rate_at(epoch) for epoch in range(recipe.epochs)]


def changed(text, **keys):
    """The recipe with keys replaced, added, or where None left out."""
    lines = [line for line in text.splitlines() if line.split(" = ")[0] not in keys]
    return "\n".join([*lines, *(f"{key} = {value}" for key, value in keys.items() if value is not None)])


def refusal(text):
    with pytest.raises(SettingsError) as caught:
        parse_recipe(text, "mine.toml")
    assert str(caught.value).startswith("mine.toml: ")
    return str(caught.value)


# --- the thesis's rows ---


@pytest.mark.parametrize("of", [*UNMARKED, *MARKED])
@pytest.mark.parametrize("name", HYPOTHESES)
def test_tables_5_1_and_5_2_have_a_recipe_a_row(name, of):
    row, meta = recipe(name, of), name.partition("-")[0]
    assert isinstance(row, HypothesisRecipe)
    assert (row.meta_loss, row.batch_size, row.start) == (meta, 64, "imagenet")
    assert row.embedded_loss == ("cyclic-cosine" if name.endswith("cosine") else "von-mises")
    assert row.hypotheses == (75 if of == "icosa" else 30)
    assert (row.epsilon, row.concentration) == (0.05, 4.0)
    rates = rates_of(row)
    expected = {
        (False, False): [1e-3] * 15 + [1e-4] * 10 + [1e-5] * 5,
        (False, True): [1e-3] * 30 + [1e-4] * 5,
        (True, False): [1e-3] * 25 + [1e-4] * 15 + [1e-5] * 10,
        (True, True): [1e-3] * 42 + [1e-4] * 8,
    }
    assert rates == expected[of in MARKED, meta == "ewta"]


@pytest.mark.parametrize(("of", "epochs_above_one"), [("tet", 20), ("icosa", 20), ("tetX", 30)])
def test_k_is_halved_until_it_is_one(of, epochs_above_one):
    made = recipe("ewta-von-mises", of)
    k = [winners_at(made, epoch) for epoch in range(made.epochs)]
    assert k[0] == (75 if of == "icosa" else 30)
    assert all(later in (earlier, earlier // 2) for earlier, later in pairwise(k))
    assert [number > 1 for number in k] == [epoch < epochs_above_one for epoch in range(len(k))]


@pytest.mark.parametrize(
    ("name", "differs"),
    [
        ("classifier", {}),
        ("classifier-best-precision", {"start": "best-precision"}),
        ("classifier-no-encoding", {"frequencies": 0}),
        ("classifier-no-pretraining", {"start": "imagenet"}),
        *((f"classifier-k{K}", {"negatives": K}) for K in KS),
    ],
)
def test_table_7_1_and_figure_7_4_have_a_recipe_a_row(name, differs):
    for of in (*UNMARKED, *MARKED):
        row = recipe(name, of)
        assert isinstance(row, ClassifierRecipe)
        expected = {"start": "best-recall", "frequencies": 3, "negatives": 256, **differs}
        assert {key: getattr(row, key) for key in expected} == expected
        assert row.batch_size == 32
        first_drop = 4 if name == "classifier-no-pretraining" and of in STARRED else 15
        rates = [1e-3] * first_drop + [1e-4] * (25 - first_drop) + [1e-5] * 5
        assert rates_of(row) == rates
        assert [row.is_frozen_at(epoch) for epoch in range(30)] == [True] * 4 + [False] * 26


def test_the_future_work_has_recipes_in_which_one_thing_is_new():
    annealed, smooth = recipe("ewta-von-mises-annealed"), recipe("ewta-von-mises-smooth")
    K = [concentration_at(annealed, epoch / 4) for epoch in range(4 * annealed.epochs)]
    assert (K[0], K[-1]) == (0.5, 4.0)
    assert all(earlier <= later < 1.1 * earlier for earlier, later in pairwise(K))
    k = [winners_at(smooth, epoch / 50) for epoch in range(50 * smooth.epochs)]
    assert (k[0], k[50 * smooth.epochs_to_one - 1], k[-1]) == (30, 1, 1)
    assert set(k) == set(range(1, 31))
    assert k == sorted(k, reverse=True)
    assert winners_at(annealed, 3) == winners_at(recipe("ewta-von-mises"), 3)


def test_the_small_tier_starts_at_random_and_says_so():
    names = [name for name in builtin_recipes() if name.startswith("small-")]
    assert len(names) == 10
    for name in names:
        small = recipe(name, "cylO")
        assert "random start" in small.title
        is_pretrained = name.startswith("small-classifier") and "no-pretraining" not in name
        assert small.start == ("best-recall" if is_pretrained else "random")


@pytest.mark.parametrize(
    ("name", "differs"),
    [
        ("no-encoding", {"frequencies": 0}),
        ("k1024", {"negatives": 1024}),
        ("f5", {"frequencies": 5}),
        ("hard-negatives", {"hard_negatives": 64}),
        ("longer", {"epochs": 12, "milestones": (8, 10)}),
        ("no-pretraining", {"start": "random", "frozen_epochs": 0}),
    ],
)
def test_small_variants_of_the_classifier_have_one_thing_new(name, differs):
    variant, plain = recipe(f"small-classifier-{name}"), recipe("small-classifier")
    assert variant == replace(plain, title=variant.title, **differs)
    assert variant.title != plain.title


REDUCED_CLASSIFIERS = [
    "classifier",
    *(f"classifier-{row}" for row in ("best-precision", "no-encoding", "no-pretraining")),
]


@pytest.mark.parametrize("name", [*HYPOTHESES, *REDUCED_CLASSIFIERS, *(f"classifier-k{K}" for K in KS)])
def test_a_reduced_row_is_the_thesiss_but_for_its_input_its_start_and_how_long_it_takes(name):
    reduced, thesis = recipe(f"reduced-{name}", "tet"), recipe(name, "tet")
    changed = {"title", "epochs", "milestones", "input_size", "frozen_epochs", "epochs_to_one"}
    if thesis.start == "imagenet":  # which cannot be had everywhere
        changed |= {"start"}
        assert reduced.start == "random"
    same = [key.name for key in fields(thesis) if key.name not in changed]
    assert [name for name in same if getattr(reduced, name) != getattr(thesis, name)] == []
    assert reduced.input_size == 32
    assert reduced.title.endswith("random start" if name in HYPOTHESES else "32 pixels")


def test_no_built_in_recipe_is_without_a_test_and_each_has_a_title_of_its_own():
    known = {
        *HYPOTHESES,
        "implicit-pdf",
        "mixture",
        "diffusion",
        "wta-von-mises-annealed",
        "ewta-von-mises-smooth-annealed",
    }
    named = set(re.findall(r'"([\w-]+)"', Path(__file__).read_text())) | {f"classifier-k{K}" for K in KS}
    names = builtin_recipes()
    assert [name for name in names if name not in known | named and not name.startswith(("small-", "reduced-"))] == []
    assert len({load_recipe(name).title for name in names}) == len(names)


def test_the_recipes_are_in_the_wheel(tmp_path):
    code = "import setuptools.build_meta as b; print(b.build_wheel(__import__('sys').argv[1]))"
    copy = tmp_path / "source"
    copied = ["pyproject.toml", "README.md", "LICENSE", "symsol_annot", "cli", "blender_assets"]
    copy.mkdir()
    for name in copied:
        subprocess.run(["cp", "-r", ROOT / name, copy], check=True)
    subprocess.run([sys.executable, "-c", code, tmp_path], cwd=copy, capture_output=True, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as content:
        found = [Path(name).stem for name in content.namelist() if "/models/recipes/" in name]
    assert sorted(found) == builtin_recipes()


# --- reading and writing ---


@pytest.mark.parametrize("name", builtin_recipes())
def test_a_recipe_written_is_read_as_it_was_and_holds_every_key(name):
    for of in ("cylO", "icosa"):
        made = recipe(name, of)
        text = recipe_to_toml(made)
        assert recipe_from_toml(text, "a checkpoint") == made
        assert "batch_size = " in text


def test_an_objects_own_keys_come_before_those_of_marked_objects():
    file = parse_recipe(
        f"{GOOD}\n[marked]\nepochs = 20\nbatch_size = 16\n[objects.cylO]\nbatch_size = 32\n", "mine.toml"
    )
    found = [file.for_object(name, has_marking=m) for name, m in (("tet", False), ("mug", True), ("cylO", True))]
    assert [(one.epochs, one.batch_size) for one in found] == [(10, 8), (20, 16), (20, 32)]


def test_a_backbone_is_a_key_that_is_left_out_where_it_is_the_default():
    plain, narrow = (parse_recipe(changed(GOOD, backbone=name), "mine.toml") for name in (None, f'"{NARROW.name}"'))
    by_default, with_narrow = (file.for_object("tet", has_marking=False) for file in (plain, narrow))
    assert (by_default.backbone, with_narrow.backbone) == ("resnet18", NARROW.name)
    assert "backbone" not in recipe_to_toml(by_default)
    assert recipe_from_toml(recipe_to_toml(with_narrow), "a checkpoint") == with_narrow


@pytest.mark.parametrize("kind", MODEL_KINDS.values(), ids=MODEL_KINDS)
def test_a_kind_of_model_is_found_by_its_recipes_and_its_figures_are_the_scorers(kind):
    made = recipe({"hypotheses": "wta-cosine"}.get(kind.name, kind.name))
    assert kind_of(made) is kind
    assert recipe_to_toml(made).startswith(f'model = "{kind.name}"\n')
    assert kind.best_by in FIGURES
    assert set(kind.tracks) <= set(TRACKS)


# --- refusals ---


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


@pytest.mark.parametrize("title", ["WTA \U0001f600", 'caf\u00e9 \\ "x" \u2028'.replace("\u2028", "\u00fc"), "." * 200])
def test_any_title_that_is_accepted_is_read_again_from_a_checkpoint(title):
    made = parse_recipe(changed(GOOD, title=json.dumps(title, ensure_ascii=False)), "mine.toml").for_object(
        "tet", has_marking=False
    )
    assert recipe_from_toml(recipe_to_toml(made), "a checkpoint") == made
