"""Making a set: which bytes it has, what is told of it, and what is refused before it is begun."""

import shutil
import threading
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
from four_shards import IMAGES, PER_SHARD, Opener, contents, small_plan, state, unopened
from made_sets import make_plan, make_set, on_images, threads
from numpy_renderer import NumpyRenderer

from symsol_annot.errors import DifferentSetError, ObjectError
from symsol_annot.generation.generate import generate
from symsol_annot.rotations.groups import octahedral_group
from symsol_annot.sets.manifest import read_manifest, write_manifest

pytestmark = pytest.mark.usefixtures("_drawn_once")


@pytest.mark.parametrize("workers", [2, 3])
def test_bytes_do_not_depend_on_the_number_of_workers(tmp_path, workers):
    plan = small_plan("tetX", train=20, test=20)
    generate(plan, tmp_path / "one", threads(Opener("tetX")))
    generate(plan, tmp_path / "more", threads(Opener("tetX"), workers=workers))
    assert contents(tmp_path / "more") == contents(tmp_path / "one")


def test_bytes_do_not_depend_on_the_order_of_work(tmp_path, undisturbed):
    others_are_made = threading.Event()

    def on_frame(number, frame):
        if number == 0:
            assert others_are_made.wait(timeout=60)
        elif frame == IMAGES - PER_SHARD:
            others_are_made.set()

    generate(small_plan(), tmp_path / "tet", threads(Opener(on_frame=on_frame), workers=2))
    assert contents(tmp_path / "tet") == contents(undisturbed)


def test_same_command_again_makes_nothing_new(tmp_path, undisturbed):
    folder = Path(shutil.copytree(undisturbed, tmp_path / "tet"))
    before = state(folder)
    manifest = generate(small_plan(), folder, threads(unopened, workers=3))
    assert manifest == read_manifest(undisturbed)
    assert state(folder) == before


def test_progress_counts_every_image_once_also_those_that_are_there_already(half):
    counted = []
    generate(small_plan(), half, threads(Opener(), workers=2), on_images(lambda: counted.append(1)))
    assert len(counted) == IMAGES
    generate(small_plan(), half, threads(unopened), on_images(lambda: counted.append(1)))
    assert len(counted) == 2 * IMAGES


def test_returned_manifest_is_the_one_on_disk_and_finished(half):
    manifest = generate(small_plan(), half, threads(Opener()))
    assert manifest == read_manifest(half)
    assert manifest.is_finished


def test_an_object_without_the_symmetries_that_it_declares_is_refused_before_anything_is_touched(tmp_path):
    plan, opened = small_plan(), Opener()
    wrong = replace(plan, spec=replace(plan.spec, symmetry_group=octahedral_group()))
    with pytest.raises(ObjectError, match=r"the surface of 'tet' is not invariant under body\.group"):
        generate(wrong, tmp_path / "tet", threads(opened))
    assert not (tmp_path / "tet").exists()
    generate(plan, tmp_path / "tet", threads(opened))
    with pytest.raises(ObjectError, match="is not invariant"):
        generate(wrong, tmp_path / "tet", threads(opened))


def test_set_begun_with_other_software_is_not_finished_with_this(tmp_path):
    folder = make_set(tmp_path, test=40)
    manifest = read_manifest(folder)
    last = manifest.shards[-1]
    (folder / last.file).unlink()
    write_manifest(folder, manifest.with_finished(replace(last, bytes=None, sha256=None, content_sha256=None)))
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    class OtherRenderer(NumpyRenderer):
        versions = MappingProxyType({"renderer": "another"})

    with pytest.raises(DifferentSetError, match="renderer: there numpy, here another"):
        generate(make_plan(test=40), folder, threads(lambda: OtherRenderer("tetX")))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
