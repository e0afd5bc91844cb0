"""Checking a set: files that are damaged, missing, strange or no files are named, and a good set has no fault."""

import os
import random
import shutil
from dataclasses import replace

import h5py
import pytest
from made_sets import make_set
from tampered_shards import SECOND, SHARDS, rows, tampered
from tampering import flip_bit

from symsol_annot.errors import DataError
from symsol_annot.sets import verify as verify_module
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.verify import verify


def state(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.mark.parametrize(
    "plan", [{"name": "tetX"}, {"name": "tet", "annotate": "all", "train": 2}, {"annotate": "none"}]
)
def test_good_set_has_no_faults(tmp_path, plan):
    assert verify(make_set(tmp_path, **{"test": 20, "size": 16, **plan})) == []


def test_resealed_set_has_no_faults(tetX_set):
    # else the tests of tampering would find what the sealing did
    with tampered(tetX_set) as shard:
        assert len(rows(shard, shown=True)) >= 2
        assert len(rows(shard, shown=False)) >= 2
    assert verify(tetX_set) == []


def test_set_is_read_and_never_written(tetX_set):
    before = state(tetX_set)
    verify(tetX_set)
    assert state(tetX_set) == before
    flip_bit(tetX_set / SECOND, 10_000)
    before = state(tetX_set)
    assert verify(tetX_set)
    assert state(tetX_set) == before


def test_progress_counts_every_shard_once(tetX_set):
    (tetX_set / SECOND).unlink()
    counted = []
    verify(tetX_set, lambda: counted.append(1))
    assert len(counted) == len(SHARDS)


def test_any_flipped_bit_is_found_and_its_shard_named(tetX_set):
    rng = random.Random(0)
    for _ in range(60):
        bits = {tetX_set / name: rng.randrange(8 * (tetX_set / name).stat().st_size) for name in SHARDS}
        for path, bit in bits.items():
            flip_bit(path, bit)
        faults = verify(tetX_set)
        assert sorted(fault.split(": expected SHA-256 ")[0] for fault in faults) == [f"{n}: is damaged" for n in SHARDS]
        for path, bit in bits.items():
            flip_bit(path, bit)
    assert verify(tetX_set) == []


@pytest.mark.parametrize("name", SHARDS)
def test_one_flipped_bit_is_one_fault(tetX_set, name):
    flip_bit(tetX_set / name, 100_000)
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{name}: is damaged: expected SHA-256 ")


@pytest.mark.parametrize("size", [0, 1, 10_000, -1])
def test_truncated_shard_is_found_with_both_sizes(tetX_set, size):
    data = (tetX_set / SECOND).read_bytes()
    (tetX_set / SECOND).write_bytes(data[:size])
    assert verify(tetX_set) == [f"{SECOND}: is damaged: expected {len(data)} bytes, found {len(data[:size])}"]


def test_shard_that_grew_is_found(tetX_set):
    data = (tetX_set / SECOND).read_bytes()
    (tetX_set / SECOND).write_bytes(data + b"\0")
    assert verify(tetX_set) == [f"{SECOND}: is damaged: expected {len(data)} bytes, found {len(data) + 1}"]


def test_missing_shard_is_found(tetX_set):
    (tetX_set / SECOND).unlink()
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: No such file or directory"]


def test_folder_in_place_of_a_shard_is_found(tetX_set):
    (tetX_set / SECOND).unlink()
    (tetX_set / SECOND).mkdir()
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: is a folder, where a file belongs"]


def test_extra_shard_is_found(tetX_set):
    shutil.copy(tetX_set / SECOND, tetX_set / "test-00003-of-00003.h5")
    assert verify(tetX_set) == ["test-00003-of-00003.h5: is no shard of this set; move it elsewhere"]


def test_shards_that_changed_places_are_found(tetX_set):
    (tetX_set / SHARDS[0]).rename(tetX_set / "aside")
    (tetX_set / SHARDS[1]).rename(tetX_set / SHARDS[0])
    (tetX_set / "aside").rename(tetX_set / SHARDS[1])
    faults = verify(tetX_set)
    assert [fault.split(": is damaged")[0] for fault in faults] == [SHARDS[0], SHARDS[1]]


def test_unfinished_set_is_found(tetX_set):
    manifest = read_manifest(tetX_set)
    entries = [entry for entry in manifest.shards if entry.split == "test"][1:]
    for entry in entries:
        (tetX_set / entry.file).unlink()
        manifest = manifest.with_finished(replace(entry, bytes=None, sha256=None, content_sha256=None))
    write_manifest(tetX_set, manifest)
    assert verify(tetX_set) == [
        f"{entry.file}: was never finished; the same render command makes it" for entry in entries
    ]


@pytest.mark.parametrize("data", [None, b"", b"{}", b"\xff"])
def test_folder_without_a_readable_manifest_is_an_error(tetX_set, data):
    (tetX_set / "manifest.json").unlink()
    if data is not None:
        (tetX_set / "manifest.json").write_bytes(data)
    with pytest.raises(DataError, match=r"manifest\.json"):
        verify(tetX_set)


def test_damaged_shard_is_never_handed_to_hdf5(tetX_set, monkeypatch):
    def refuse(*arguments, **options):
        pytest.fail(f"HDF5 was given {arguments}")

    for number, name in enumerate(SHARDS):
        flip_bit(tetX_set / name, 10_000 + number)
    owners = ((h5py, "File"), (verify_module, "open_shard"), (shards._DESCRIBER, "describe"))
    for owner, name in owners:
        monkeypatch.setattr(owner, name, refuse)
    faults = verify(tetX_set)
    assert sorted(fault.split(":")[0] for fault in faults) == sorted(SHARDS)


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_shard_that_is_no_regular_file_is_named_and_not_waited_for(tetX_set, kind):
    (tetX_set / SECOND).unlink()
    if kind == "pipe":
        os.mkfifo(tetX_set / SECOND)
    else:
        (tetX_set / SECOND).symlink_to("/dev/zero")
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: is no regular file"]
