"""A damaged set made whole again has the bytes that it had; one that would get other bytes is left alone."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from made_sets import SIZE, on_images, threads
from numpy_renderer import NumpyRenderer

from symsol_annot.errors import DataError, DifferentSetError
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.verify import verify

open_renderer = partial(NumpyRenderer, "tetX", SIZE)


@pytest.fixture
def plan(tetX_set):
    return SetPlan.behind(read_manifest(tetX_set), load_object("tetX"))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def flip_a_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 8
    path.write_bytes(data)


def unopened():
    pytest.fail("a renderer was started")


@pytest.mark.parametrize("damage", [flip_a_bit, Path.unlink, lambda path: os.truncate(path, 100)])
def test_a_repaired_set_is_the_undisturbed_one_byte_for_byte(tetX_set, plan, damage):
    before, seen = contents(tetX_set), []
    damage(tetX_set / "test-00001-of-00003.h5")
    assert verify(tetX_set) != []
    generate(plan, tetX_set, threads(open_renderer), on_images(lambda: seen.append(1)), repair=True)
    assert contents(tetX_set) == before
    assert len(seen) == 45  # those of whole shards count as well
    assert verify(tetX_set) == []


def test_all_shards_of_a_set_may_be_missing(tetX_set, plan):
    before = contents(tetX_set)
    for path in tetX_set.glob("*.h5"):
        path.unlink()
    generate(plan, tetX_set, threads(open_renderer, workers=2), repair=True)
    assert contents(tetX_set) == before


def test_without_repair_damaged_shards_are_named_and_left_alone(tetX_set, plan):
    flip_a_bit(tetX_set / "test-00001-of-00003.h5")
    before = contents(tetX_set)
    with pytest.raises(DataError, match=r"damaged: test-00001-of-00003\.h5\..*--repair"):
        generate(plan, tetX_set, threads(unopened))
    assert contents(tetX_set) == before


class DarkerRenderer(NumpyRenderer):
    """What other software might draw."""

    def render(self, R_m2c):
        view = super().render(R_m2c)
        return replace(view, rgb=view.rgb // 2)


def test_a_repair_that_gives_other_bytes_is_refused_and_nothing_is_written(tetX_set, plan):
    flip_a_bit(tetX_set / "test-00001-of-00003.h5")
    before = contents(tetX_set)
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: made again, its SHA-256 is .* other software"):
        generate(plan, tetX_set, threads(partial(DarkerRenderer, "tetX", SIZE)), repair=True)
    assert contents(tetX_set) == before


def test_a_set_is_not_repaired_with_another_object(tetX_set):
    flip_a_bit(tetX_set / "test-00001-of-00003.h5")
    plan = SetPlan.behind(read_manifest(tetX_set), load_object("cylO"))
    with pytest.raises(DifferentSetError, match="object"):
        generate(plan, tetX_set, threads(unopened), repair=True)


def test_the_plan_of_a_set_is_the_one_it_was_made_by(tetX_set, plan):
    assert plan.manifest().differences(read_manifest(tetX_set)) == []
