"""The card of the published sets: written from figures in the tree, which are measured as `publish` measures them."""

import json
from pathlib import Path

import dataset_card
import pytest

from symsol_annot.objects.spec import load_object
from symsol_annot.publish.figures import from_document, measure_labels, to_document
from symsol_annot.publish.sets import PublishedSet
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.sample_set import sample_folder


def kept():
    return json.loads(dataset_card.FIGURES.read_text())


def test_the_card_in_the_tree_states_the_figures_in_the_tree():
    """If this fails: `make card`."""
    assert dataset_card.CARD.read_text() == dataset_card.rendered()


def test_another_figure_makes_another_card(tmp_path, monkeypatch):
    document = kept()
    document["tetX"]["test"]["statistics"]["shown"] += 1
    (tmp_path / "figures.json").write_text(json.dumps(document))
    monkeypatch.setattr(dataset_card, "FIGURES", tmp_path / "figures.json")
    assert dataset_card.CARD.read_text() != dataset_card.rendered()


def test_the_card_is_about_the_published_sets_and_each_of_their_test_splits():
    assert set(kept()) == set(dataset_card.objects())
    assert all(split["test"]["statistics"]["images"] == 5000 for split in kept().values())


def test_the_kept_figures_add_up():
    for name, splits in kept().items():
        order = len(load_object(name).symmetry_group)
        for split, found in splits.items():
            counted = found["statistics"]
            with_volume = sum(counted.get("measures", {}).values())
            assert (with_volume > 0) == load_object(name).has_all_rotations
            assert counted["images"] == sum(counted["set_sizes"].values()) + with_volume == dataset_card.IMAGES[split]
            assert found["group_order"] == order >= max(map(int, counted["set_sizes"]))
            assert counted["candidates_within_tolerance"] <= counted["candidates_drawn"] <= counted["images"] * order
            assert (found["barely"] or 0) <= counted["shown"] <= counted["images"]


def test_figures_come_back_from_json_as_they_were():
    figures = from_document(kept())
    assert to_document(figures) == kept()
    assert from_document(json.loads(json.dumps(to_document(figures)))) == figures


@pytest.mark.blender
@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_labels_that_are_made_without_pictures_give_the_figures_of_the_rendered_set(name):
    folder = Path(sample_folder()) / name
    manifest = read_manifest(folder)
    rendered = measure_labels(PublishedSet(name, folder, manifest), "test")
    assert rendered.statistics.images == 64
    plan = SetPlan.behind(manifest, load_object(name))
    only_test = SetPlan(plan.spec, {"test": 64}, plan.seed, plan.camera, plan.settings, "all")
    assert dataset_card.of_labels(only_test, "test") == rendered
