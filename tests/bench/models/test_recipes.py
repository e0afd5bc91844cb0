"""Recipes: each row of the thesis's tables has one with its settings, and what is written is read as it was."""

import json
import re
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import pytest
from recipe_texts import GOOD, changed
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

KS = (64, 128, 512, 1024)  # of figure 7.4, beside the baseline's 256

ROOT = Path(__file__).resolve().parents[3]
UNMARKED, MARKED = ("tet", "cube", "icosa", "cone", "cyl"), ("tetX", "cylO")
HYPOTHESES = [f"{meta}-{loss}" for meta in ("wta", "rwta", "ewta") for loss in ("cosine", "von-mises")]
STARRED = ("cube", "cone", "cyl", "tetX", "cylO")  # in table 7.1: the rate is 1e-4 from epoch 4


def recipe(name, of="tet"):
    return load_recipe(name).for_object(of, has_marking=of in MARKED)


def rates_of(recipe):
    return [recipe.learning_rate_at(epoch) for epoch in range(recipe.epochs)]


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


@pytest.mark.parametrize(
    ("name", "differs"),
    [
        ("volume-classifier-unweighted", {}),
        ("volume-classifier-outside", {"negatives_outside": True}),
        ("volume-classifier", {"negatives_weight": 0.2}),
    ],
)
def test_classifiers_of_volumes_differ_in_what_negatives_weigh_alone(name, differs):
    one, plain = recipe(name, "sphereX"), recipe("volume-classifier-unweighted", "sphereX")
    assert one == replace(plain, title=one.title, **differs)
    assert one.statistics_images == 2048


@pytest.mark.parametrize("name", ["mixture", "implicit-pdf", "diffusion"])
def test_of_spherex_alone_statistics_are_those_of_many_images(name):
    assert recipe(name, "sphereX").statistics_images == 2048
    assert {recipe(name, other).statistics_images for other in ("tet", "cube", "icosa", "cone", "cyl", "tetX")} == {0}


def test_a_diffusion_of_bodies_without_a_marking_tells_rotations_by_waves():
    for of in UNMARKED:
        made = recipe("diffusion", of)
        assert (made.waves, made.frequencies, made.noise_median, made.draws) == (320, 0, 0.15, 64)
    for of in (*MARKED, "sphereX"):
        made = load_recipe("diffusion").for_object(of, has_marking=True)
        assert (made.waves, made.frequencies, made.noise_median, made.draws) == (0, 5, 0.0, 32)


@pytest.mark.parametrize(("of", "expected"), [("icosa", 75), ("tet", 30), ("cylO", 30), ("sphereX", 30)])
def test_a_diffusion_lists_as_many_hypotheses_as_the_thesis(of, expected):
    assert recipe("diffusion", of).hypotheses == expected


@pytest.mark.parametrize("name", ["tet", "cyl", "tetX", "cylO", "sphereX"])
def test_the_mixture_of_64_pixels_differs_in_its_input_alone(name):
    larger, plain = recipe("mixture-64", name), recipe("mixture", name)
    assert larger == replace(plain, title=larger.title, input_size=64)


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


@pytest.mark.parametrize("title", ["WTA \U0001f600", 'caf\u00e9 \\ "x" \u2028'.replace("\u2028", "\u00fc"), "." * 200])
def test_any_title_that_is_accepted_is_read_again_from_a_checkpoint(title):
    made = parse_recipe(changed(GOOD, title=json.dumps(title, ensure_ascii=False)), "mine.toml").for_object(
        "tet", has_marking=False
    )
    assert recipe_from_toml(recipe_to_toml(made), "a checkpoint") == made
