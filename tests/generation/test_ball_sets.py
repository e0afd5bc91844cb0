"""Sets of a ball with parts, from its files to what is loaded, read by h5py alone, verified, audited and counted."""

import dataclasses
import hashlib
import json
import re
import zlib
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from balls import CAP, CAP_FACES, BallRenderer, ball, ball_toml
from click.testing import CliRunner
from made_sets import threads
from symsol_annot_cli.info import info
from tampering import reseal

from symsol_annot import load
from symsol_annot.annotation.volume import CELLS, Volume
from symsol_annot.errors import DataError
from symsol_annot.generation.audit import audit
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.membership import checked_shard
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.laws import label_faults
from symsol_annot.sets.verify import verify
from symsol_annot.torch import SymsolDataset

ROOT = Path(__file__).resolve().parents[2]
IMAGES = 20  # in two shards


def plan_of(folder, toml, mesh, images=IMAGES):
    folder.mkdir(exist_ok=True)
    (folder / "object.toml").write_text(toml)
    (folder / "mesh.obj").write_text(mesh)
    return SetPlan(read_object(folder), {"test": images}, 0, Camera.filling(16), RenderSettings(), "test")


def renderer_of(plan):
    return partial(BallRenderer, plan.spec, plan.camera)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return plan_of(tmp_path_factory.mktemp("object"), ball_toml(CAP), ball({"red": CAP_FACES}))


@pytest.fixture(scope="module")
def made(plan, tmp_path_factory):
    """The folder of a set that no test changes."""
    folder = tmp_path_factory.mktemp("sets") / "thing"
    generate(plan, folder, threads(renderer_of(plan)))
    return folder


@pytest.fixture
def folder(made, tmp_path):
    for path in made.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_set_holds_the_volume_of_images_that_show_nothing_and_turns_of_the_others(plan, made):
    assert verify(made) == []
    images = load(made, "test")
    labels = images.labels()
    (volume,) = labels.volumes
    np.testing.assert_array_equal(labels.volume >= 0, ~labels.marking_visible)
    assert 2 < labels.marking_visible.sum() < IMAGES - 2
    for row, sample in enumerate(images):
        assert sample.volume == (None if labels.marking_visible[row] else volume)
        assert sample.symmetry_set.volume == labels.symmetry_set(row).volume == sample.volume
        assert sample.symmetry_set.contains(sample.rotation[None]).all()
    assert "of all rotations" in repr(images[int(np.argmin(labels.marking_visible))])
    assert images[3:7].labels().volume.tolist() == labels.volume[3:7].tolist()


def test_the_lines_of_the_format_page_read_a_volume(made):
    """Exactly those lines, with h5py alone."""
    block = re.findall(r"```python\n(.*?)```", (ROOT / "docs/format.md").read_text(), flags=re.DOTALL)[1]
    assert len(block.strip().splitlines()) == 2
    images = load(made, "test")
    with h5py.File(made / "test-00000-of-00002.h5") as file:
        for row in range(len(file["image"])):
            names = {"np": np, "zlib": zlib, "f": file, "i": row}
            exec(block, names)
            volume = images[row].volume
            assert (names["cells"] is None) == (volume is None)
            assert volume is None or np.array_equal(names["cells"], volume.mask)


def test_the_number_of_workers_the_way_and_a_resumption_do_not_change_the_set(plan, made, folder):
    (folder / "test-00001-of-00002.h5").unlink()
    whole = threads(renderer_of(plan), workers=2, exhaustive=True)
    assert generate(plan, folder, whole, repair=True).fingerprint == read_manifest(made).fingerprint
    for name in ("test-00000-of-00002.h5", "test-00001-of-00002.h5"):
        assert (folder / name).read_bytes() == (made / name).read_bytes()


def test_torch_items_have_the_mask_and_the_index_of_the_volume(made):
    items = SymsolDataset(str(made), "test")
    assert [items[row]["volume"] for row in range(6)] == load(made, "test").labels().volume[:6].tolist()


def test_an_audit_draws_inside_outside_and_at_the_edge_and_finds_a_wrong_volume(plan, made):
    images, renderer = load(made, "test"), renderer_of(plan)()
    report = audit(images, plan, renderer, 3, np.random.default_rng(1))
    assert report.faults == []
    assert min(report.inside, report.beyond, report.at_edge) > 0

    class Wrong:
        """Has another volume."""

        def __getattr__(self, name):
            return getattr(images, name)

        def __len__(self):
            return len(images)

        def __getitem__(self, row):
            sample = images[row]
            return sample if sample.volume is None else dataclasses.replace(sample, volume=Volume(~sample.volume.mask))

    faults = "\n".join(audit(Wrong(), plan, renderer, 3, np.random.default_rng(1)).faults)
    assert "inside its volume shows a part" in faults
    assert "outside its volume shows nothing" in faults
    assert "degrees off its volume" in faults


def test_labels_that_break_a_law_of_volumes_are_found(made):
    manifest = read_manifest(made)
    shard, labels = checked_shard(made, manifest, manifest.shards[0])
    hidden = int(np.argmax(labels.volume))
    shown = int(np.argmin(labels.volume))

    def faults(**changes):
        return "\n".join(label_faults(shard, dataclasses.replace(labels, **changes)))

    def with_volume(row, index):
        volume = labels.volume.copy()
        volume[row] = index
        return volume

    assert faults() == ""
    assert "shows a part that breaks the symmetry, and yet has a volume" in faults(volume=with_volume(shown, 0))
    assert "images that show nothing have different volumes" in faults(volume=with_volume(hidden, -1))
    assert "is not among the 1 volumes" in faults(volume=with_volume(hidden, 1))
    assert "belongs to no image" in faults(volumes=(*labels.volumes, Volume(np.ones(CELLS, bool))))
    twice = labels.symmetry_group.copy()
    twice[3] = twice[2]
    assert "is there twice" in faults(symmetry_group=twice)


def another_level(shard):
    set_volumes(shard, np.full(294912 // 8, 255, np.uint8).tobytes())


def set_volumes(shard, data):
    shard.attrs["volumes"] = np.frombuffer(zlib.compress(data), np.uint8)
    shard.attrs["volumes_sha256"] = hashlib.sha256(data).hexdigest()


def cut(shard):
    shard.attrs["volumes"] = shard.attrs["volumes"][:-5]


def changed(shard):
    shard.attrs["volumes"] = np.frombuffer(zlib.compress(bytes(294911) + b"\1"), np.uint8)


DAMAGES = {
    "a mask of another level": (another_level, "a mask of another level"),
    "an empty mask": (lambda shard: set_volumes(shard, bytes(294912)), "a volume is empty, or there twice"),
    "a stream that ends early": (cut, "its end is missing"),
    "another mask": (changed, "does not have the digest in 'volumes_sha256'"),
    "a bomb": (lambda shard: set_volumes(shard, bytes(17 * 294912)), "at most 4718592 bytes"),
    "no attribute": (lambda shard: shard.attrs.__delitem__("volumes"), "'volumes' is missing, in an annotated split"),
    "no data set": (lambda shard: shard.__delitem__("volume"), "'volume' is missing, in an annotated split"),
    "floats": (lambda shard: shard.attrs.create("volumes", np.zeros(3)), r"expected |u1 of shape"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_volumes_are_refused_with_what_is_wrong(folder, damage):
    change, expected = DAMAGES[damage]
    with h5py.File(folder / "test-00000-of-00002.h5", "r+") as shard:
        change(shard)
    reseal(folder, contents=False)
    with pytest.raises(DataError, match=re.escape(expected)) as caught:
        load(folder, "test")[0]
    assert "test-00000-of-00002.h5" in str(caught.value)
    assert any(expected in fault for fault in verify(folder))


def test_volumes_in_a_set_without_any_are_refused(tetX_set):
    with h5py.File(tetX_set / "test-00000-of-00003.h5", "r+") as shard:
        set_volumes(shard, bytes(294911) + b"\1")
    reseal(tetX_set, contents=False)
    with pytest.raises(DataError, match="'volumes' is there, in a set without volumes"):
        load(tetX_set, "test")[0]


def test_shards_with_different_volumes_are_found(folder):
    with h5py.File(folder / "test-00001-of-00002.h5", "r+") as shard:
        set_volumes(shard, np.full(294912, 255, np.uint8).tobytes())
    reseal(folder)
    assert any("fill another volume than those of test-00000" in fault for fault in verify(folder))


def test_info_tells_of_sets_that_fill_a_volume_apart_from_sizes(made):
    said = CliRunner().invoke(info, [str(made)]).output
    assert re.search(r"\|S\|: \d\d\.\d% of all rotations in \d+, 24 in \d+", said)
    split = json.loads(CliRunner().invoke(info, [str(made), "--json"]).output)["splits"]["test"]
    assert sum(entry["images"] for entry in split["images_with_volume"]) + split["set_sizes"]["24"] == IMAGES


def test_a_plain_ball_has_all_rotations_in_every_image(tmp_path):
    plan = plan_of(tmp_path / "object", ball_toml(), ball(), images=2)
    generate(plan, tmp_path / "set", threads(renderer_of(plan)))
    assert verify(tmp_path / "set") == []
    images = load(tmp_path / "set", "test")
    assert [sample.symmetry_set.measure for sample in images] == [1.0, 1.0]
    assert audit(images, plan, renderer_of(plan)(), 2, np.random.default_rng(0)).faults == []
