"""docs/thesis_classifiers.py: what it takes from trainings, and the table that it makes of them."""

import dataclasses
import json
from types import SimpleNamespace

import pytest
import thesis_classifiers
from baseline_rows import BaselineError
from made_sets import make_set
from tiny_training import CPU
from written_tables import END, beginning

from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.bench.models.training.loop import train
from symsol_annot.sets.dataset import load

FIGURES = {"f_measure": 0.5, "recall": 0.25, "precision": 0.75, "first_stage": "", "recipe": "", "processor_minutes": 1}
NAME = "classifier-no-pretraining"


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A page and a file of results to write to."""
    begin = beginning("thesis_classifiers.py")
    (tmp_path / "page.md").write_text(f"before\n{begin}\nold\n{END}\nafter\n{begin.upper()}\nother\n{END}\n")
    monkeypatch.setattr(thesis_classifiers, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(thesis_classifiers, "RESULTS", tmp_path / "results.json")
    return tmp_path


@pytest.fixture(scope="module")
def quick():
    """A recipe of the thesis's at a size for a test."""
    return dataclasses.replace(
        load_recipe(f"reduced-{NAME}").for_object("tetX", has_marking=True),
        start="random",
        input_size=16,
        epochs=1,
        frozen_epochs=0,
        milestones=(),
        learning_rates=(1e-3,),
        batch_size=8,
        validation_images=8,
        negatives=8,
    )


def test_every_row_has_a_recipe_of_one_thing_changed():
    recipes = {
        name: load_recipe(f"reduced-{name}").for_object("tetX", has_marking=True) for name in thesis_classifiers.ROWS
    }
    base = vars(recipes["classifier"])
    for name, recipe in recipes.items():
        differing = {key for key, value in vars(recipe).items() if value != base[key]} - {"title"}
        if name == "classifier-no-pretraining":  # whose learning rate is another, too, as the thesis has it
            assert differing >= {"start"}
        else:
            assert len(differing) == (0 if name == "classifier" else 1), name


def test_figures_are_those_of_the_records_of_finished_trainings_alone(kept, quick, tmp_path, monkeypatch):
    images = load(make_set(tmp_path / "sets", train=24, test=0, size=32, annotate="all"), "train")
    out = tmp_path / "runs" / f"tetX-reduced-{NAME}"
    assert thesis_classifiers.finished(tmp_path) == {}
    train(quick, images, out, CPU, name=f"reduced-{NAME}")
    with pytest.raises(BaselineError, match="is of another recipe than"):
        thesis_classifiers.finished(tmp_path)
    monkeypatch.setattr(thesis_classifiers, "load_recipe", lambda _: SimpleNamespace(for_object=lambda *_, **__: quick))
    found = thesis_classifiers.finished(tmp_path)
    assert list(found) == [NAME]
    assert list(found[NAME]) == ["tetX"]
    last = read_record(out / "weights.safetensors").rows[-1]
    for figure in thesis_classifiers.FIGURES:
        assert found[NAME]["tetX"][figure] == round(last[figure], 4)


def test_what_is_not_in_the_folder_stays_and_the_table_has_the_thesiss_figures(kept):
    thesis_classifiers.keep({"classifier": {"tetX": FIGURES}})
    thesis_classifiers.keep(
        {"classifier": {"cylO": {**FIGURES, "f_measure": 0.625}}, "classifier-k64": {"tetX": FIGURES}}
    )
    thesis_classifiers.write_table()
    assert list(json.loads((kept / "results.json").read_text())) == ["classifier", "classifier-k64"]
    lines = (kept / "page.md").read_text().splitlines()
    assert "| baseline: first stage by best recall, K = 256 | 0.408 | 0.500 | 0.603 | 0.625 |" in lines
    assert "| K = 64 |  | 0.500 |  |  |" in lines
    assert "old" not in lines
    assert lines[-2:] == ["other", END]
