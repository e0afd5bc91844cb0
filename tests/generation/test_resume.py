"""What a set's folder may hold when a set is made in it, and what may arrive for it."""

import errno
import hashlib
import io
import os
import shutil
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import pytest
from made_sets import SIZE, make_plan, make_set, threads
from numpy_renderer import NumpyRenderer

from symsol_annot.errors import ClusterError, DataError, OutputError
from symsol_annot.generation.events import ForeignShardsFound, ImagesMade, ShardFinished, Started, WorkersGone
from symsol_annot.generation.executors import in_process
from symsol_annot.generation.generate import generate
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.verify import verify
from symsol_annot.system import locks

PLAN = make_plan("tetX", test=40)
open_renderer = partial(NumpyRenderer, "tetX", SIZE)
LAST = "test-00002-of-00003.h5"


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def unopened(_):
    pytest.fail("an executor was opened")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return make_set(tmp_path_factory.mktemp("whole"), test=40)


@pytest.fixture
def unlisted(whole, tmp_path):
    """A set whose last shard is in the folder and not in the manifest, as a kill between the two leaves it."""
    folder = Path(shutil.copytree(whole, tmp_path / "tetX"))
    manifest = read_manifest(folder)
    last = replace(manifest.shards[-1], bytes=None, sha256=None, content_sha256=None)
    write_manifest(folder, manifest.with_finished(last))
    return folder


# What is there


def test_a_shard_that_a_killed_run_wrote_but_did_not_list_is_not_written_again(unlisted, whole):
    before = (unlisted / LAST).stat().st_mtime_ns
    generate(PLAN, unlisted, threads(open_renderer))
    assert (unlisted / LAST).stat().st_mtime_ns == before
    assert contents(unlisted) == contents(whole)


def other_seed(path):
    with h5py.File(path, "r+") as shard:
        shard.attrs["seed"] = 7


def replace_by_folder(path):
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("make_foreign", [other_seed, lambda path: path.write_bytes(b"mine"), replace_by_folder])
def test_foreign_files_under_the_names_of_shards_are_named_and_left_alone_without_repair(unlisted, make_foreign):
    make_foreign(unlisted / LAST)
    with pytest.raises(DataError, match=rf"no shards of this set.*{LAST}.*left as they are.*--repair"):
        generate(PLAN, unlisted, unopened)


def test_a_foreign_file_that_looks_like_the_shard_is_left_alone_when_the_shard_arrives(unlisted):
    with h5py.File(unlisted / LAST, "r+") as shard:
        shard["marking_pixels"][0] += 1
    before = (unlisted / LAST).read_bytes()
    with pytest.raises(DataError, match=rf"{LAST}: is there already, unknown to the manifest.*--repair"):
        generate(PLAN, unlisted, threads(open_renderer))
    assert (unlisted / LAST).read_bytes() == before


@pytest.mark.parametrize("make_foreign", [other_seed, lambda path: path.write_bytes(b"mine")])
def test_with_repair_foreign_files_are_replaced(unlisted, whole, make_foreign):
    make_foreign(unlisted / LAST)
    generate(PLAN, unlisted, threads(open_renderer), repair=True)
    assert contents(unlisted) == contents(whole)


@pytest.mark.parametrize("name", ["manifest.json", LAST])
def test_links_out_of_the_folder_are_refused_and_nothing_is_written(unlisted, tmp_path, name):
    elsewhere = tmp_path / "elsewhere"
    (unlisted / name).rename(elsewhere)
    (unlisted / name).symlink_to(elsewhere)
    before = elsewhere.read_bytes()
    with pytest.raises(OutputError, match=rf"{name}: is a symbolic link to {elsewhere}, outside the set's folder"):
        generate(PLAN, unlisted, unopened)
    assert elsewhere.read_bytes() == before


def test_what_looks_like_a_half_written_file_is_somebodys_and_a_link_is_not_followed(unlisted, whole, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine")
    name = f".{LAST}.partial"
    (unlisted / name).symlink_to(elsewhere)
    (unlisted / LAST).unlink()
    generate(PLAN, unlisted, threads(open_renderer))
    assert elsewhere.read_text() == "mine"
    assert (unlisted / name).readlink() == elsewhere
    assert contents(unlisted) == {**contents(whole), name: b"mine"}


def test_an_output_folder_may_itself_be_a_link(whole, tmp_path):
    (tmp_path / "big disk").mkdir()
    (tmp_path / "tetX").symlink_to(tmp_path / "big disk")
    generate(PLAN, tmp_path / "tetX", threads(open_renderer))
    assert contents(tmp_path / "big disk") == contents(whole)


@pytest.mark.parametrize("code", [errno.EBADF, errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_no_error(whole, tmp_path, monkeypatch, code):
    """NFS locks no folder; Lustre may know no locks."""

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(locks.fcntl, "flock", refuse)
    generate(PLAN, tmp_path / "tetX", threads(open_renderer))
    assert contents(tmp_path / "tetX") == contents(whole)


# What arrives


class Altering:
    """An executor whose shards are altered on their way; `capacities` are what it says of its workers, in turn."""

    def __init__(self, plan, alter, capacities=(1,)):
        self._alter, self._capacities = alter, list(capacities)
        self._inner = in_process(plan, open_renderer)

    def capacity(self):
        return self._capacities.pop(0) if len(self._capacities) > 1 else self._capacities[0]

    def prepare(self, shards):
        self._inner.prepare(shards)

    def submit(self, entry, on_images):
        outcome = Future()
        outcome.set_result(self._alter(entry, self._inner.submit(entry, on_images).result()))
        return outcome

    def __enter__(self):
        self._inner.__enter__()
        return self

    def __exit__(self, *exc):
        self._inner.__exit__(*exc)


def sealed(made, data):
    return replace(made, data=data, sha256=hashlib.sha256(data).hexdigest())


def with_attribute(made, name, value):
    """The shard with another attribute, whole otherwise."""
    buffer = io.BytesIO(made.data)
    with h5py.File(buffer, "r+") as shard:
        shard.attrs[name] = value
    return sealed(made, buffer.getvalue())


ARRIVALS = {
    "a bit flipped on the way": (
        lambda entry, made: replace(made, data=made.data[:999] + bytes([made.data[999] ^ 1]) + made.data[1000:]),
        "its bytes are not those that were made",
    ),
    "cut short": (
        lambda entry, made: sealed(made, made.data[:-100]),
        "^test-00000-of-00003.h5, as it arrived from its worker: cannot be read as HDF5",
    ),
    "no shard": (lambda entry, made: sealed(made, b"hello"), "cannot be read as HDF5"),
    "of another seed": (lambda entry, made: with_attribute(made, "seed", 1), "is another shard.*\n.*'seed'"),
    "other images": (lambda entry, made: with_attribute(made, "first_index", 3), "attribute 'first_index'"),
}


@pytest.mark.parametrize("case", ARRIVALS)
def test_a_shard_that_is_not_the_one_asked_for_is_refused_on_arrival(tmp_path, case):
    alter, words = ARRIVALS[case]
    with pytest.raises(DataError, match=words):
        generate(PLAN, tmp_path / "tetX", partial(Altering, alter=alter))
    assert not (tmp_path / "tetX").exists()


def test_too_few_images_are_refused_on_arrival(tmp_path):
    def shorter(entry, made):
        other = replace(entry, images=entry.images - 1)
        return in_process(PLAN, open_renderer).submit(other, lambda _: None).result()

    with pytest.raises(DataError, match=r"test-00000-of-00003\.h5.*\n.*expected 16 images, found 15"):
        generate(PLAN, tmp_path / "tetX", partial(Altering, alter=shorter))


def test_workers_with_unlike_software_are_refused_and_what_is_finished_is_kept(tmp_path, whole):
    def second_has_another(entry, made):
        made = replace(made, worker=f"node{entry.first_index // 16}")
        return with_attribute(made, "versions", '{"mesa": "1"}') if entry.first_index else made

    words = r"node1 makes shards with other software than node0.*mesa: there None, here 1"
    with pytest.raises(ClusterError, match=words):
        generate(PLAN, tmp_path / "tetX", partial(Altering, alter=second_has_another))
    assert set(contents(tmp_path / "tetX")) == {"manifest.json", "test-00000-of-00003.h5"}
    generate(PLAN, tmp_path / "tetX", threads(open_renderer))
    assert contents(tmp_path / "tetX") == contents(whole)


# What is told


def test_events_tell_what_was_there_each_image_once_and_each_shard_with_its_worker(unlisted):
    events = []
    generate(PLAN, unlisted, threads(open_renderer), events.append)
    assert events[0] == Started(images=40, shards=3, images_there=32, shards_there=2)
    assert sum(event.images for event in events if isinstance(event, ImagesMade)) == 8
    assert [event for event in events if isinstance(event, ShardFinished)] == [ShardFinished(LAST, 8, "")]


def test_shards_of_nobody_are_told_of_and_left_alone(unlisted):
    events = []
    (unlisted / "another.h5").write_bytes(b"mine")
    generate(PLAN, unlisted, threads(open_renderer), events.append)
    assert [event for event in events if isinstance(event, ForeignShardsFound)] == [ForeignShardsFound(("another.h5",))]
    assert (unlisted / "another.h5").read_bytes() == b"mine"


def test_a_time_without_workers_is_told_of_once(tmp_path):
    events = []
    unaltered = partial(Altering, alter=lambda entry, made: made, capacities=(0, 0, 1, 0))
    generate(make_plan("tetX", test=80), tmp_path / "tetX", unaltered, events.append)
    assert sum(isinstance(event, WorkersGone) for event in events) == 2
    assert verify(tmp_path / "tetX") == []
