"""docs/effects.py: trainings that differ in one thing, and the table of what came of them."""

import json

import effects
import pytest
from made_sets import make_set
from written_tables import END, beginning

from symsol_annot.bench.models.recipe import parse_recipe
from symsol_annot.errors import WeightsError

QUICK = {"input_size": 16, "epochs": 1, "batch_size": 8, "validation_images": 8}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return make_set(tmp_path_factory.mktemp("sets"), train=24, test=0, size=16, annotate="all")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A page and a file of results to write to."""
    (tmp_path / "page.md").write_text(f"before\n{beginning('effects.py')}\nold\n{END}\nafter\n")
    monkeypatch.setattr(effects, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(effects, "RESULTS", tmp_path / "effects.json")
    monkeypatch.setattr(effects, "SPEEDS", tmp_path / "effect_speeds.json")
    return tmp_path


@pytest.mark.parametrize("name", effects.EFFECTS)
def test_a_recipe_differs_from_the_base_in_what_it_says(name):
    recipes = [
        parse_recipe(effects.recipe_text(one), one).for_object("tetX", has_marking=True)
        for one in (name.partition(",")[0], name)
    ]
    differing = {key for key in vars(recipes[0]) if getattr(recipes[0], key) != getattr(recipes[1], key)}
    assert differing - {"title"} == set(effects.EFFECTS[name])


@pytest.mark.parametrize("name", ["classifier, logit from 0", "mixture, one member"])
def test_a_training_is_done_once_and_its_figures_are_those_of_its_record(images, tmp_path, name):
    found = effects.measured(name, 0, images, tmp_path, QUICK)
    (file,) = (tmp_path / "runs").glob("*-0/weights.safetensors")
    before = file.stat().st_mtime_ns
    assert effects.measured(name, 0, images, tmp_path, QUICK) == found
    assert file.stat().st_mtime_ns == before
    record = effects.read_record(file)
    assert found.f_measure == round(record.calibration["f_measure"], 4)
    if name.startswith("classifier"):
        assert (found.unfitted_f_measure, found.log_likelihood) == (round(record.rows[-1]["f_measure"], 4), None)
    else:
        likelihood = round(record.rows[-1]["log_likelihood_at_gt"], 3)
        assert (found.unfitted_f_measure, found.log_likelihood) == (None, likelihood)
    assert found.images_per_second > 0.0
    with pytest.raises(WeightsError, match="is of another recipe"):
        effects.measured(name, 0, images, tmp_path, {**QUICK, "clip_norm": 1.0})


ONE, OTHER = "classifier, one member", "mixture"
OF_ONE = effects.Measured(0.5, 0.25, None, 100.0, 1.0)


def test_the_table_has_each_training_with_its_seeds_in_the_order_of_the_list(kept):
    effects.keep(ONE, 0, OF_ONE)
    for seed in (0, 1):
        effects.keep(OTHER, seed, effects.Measured(0.1 + seed / 10, None, 3.0 + seed, 90.0 + seed, 1.0))
    effects.SPEEDS.write_text(json.dumps({"training": {ONE: {"speed": 1.256}, OTHER: {"per_second": 400.0}}}))
    effects.write_table()
    assert list(json.loads((kept / "effects.json").read_text())) == [OTHER, ONE]
    lines = (kept / "page.md").read_text().splitlines()
    assert lines[0] == "before"
    assert lines[-1] == "after"
    assert "| mixture: nothing | 0.100, 0.200 |  | 3.000, 4.000 |  |" in lines
    assert "| classifier: `members = 1` | 0.500 | 0.250 |  | 1.26 |" in lines
    assert "old" not in lines


def test_what_the_file_has_of_another_recipe_is_not_known_and_goes(kept):
    effects.keep(ONE, 0, OF_ONE)
    assert effects.is_known(ONE, 0)
    assert not effects.is_known(ONE, 1)
    assert not effects.is_known(OTHER, 0)
    effects.keep(ONE, 1, OF_ONE, QUICK)
    assert not effects.is_known(ONE, 1)
    assert list(json.loads((kept / "effects.json").read_text())[ONE]["seeds"]) == ["1"]
