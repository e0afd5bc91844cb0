"""How much memory a shard may take, whatever it holds."""

import re
import tracemalloc
import zlib
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_shards import LAYOUT, read_all, refusal
from tampering import put

from symsol_annot.errors import DataError
from symsol_annot.sets.shard import reader as shards

pytestmark = pytest.mark.usefixtures("started")


def peak_bytes(pid):
    """Return the most memory that a process has held since `reset_peak`."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def reset_peak(pid):
    Path(f"/proc/{pid}/clear_refs").write_text("5")


def huge_attribute(file):
    file.attrs["note"] = "x" * 2**26


def huge_attribute_in_place_of_a_number(file):
    file.attrs["seed"] = "x" * 2**26


def many_references_to_one_text(file):
    file.attrs.create("format", np.array(["x" * 2**16] * 1000, dtype=object), dtype=h5py.string_dtype())


def huge_data_set(file):
    file["note"] = np.zeros(2**23)


def huge_labels(file):
    put(file, "rotation", np.zeros((2**20, 3, 3)), chunks=(2**20, 3, 3))


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak of memory is told by Linux")
@pytest.mark.parametrize(
    "put_in",
    [
        huge_attribute,
        huge_attribute_in_place_of_a_number,
        many_references_to_one_text,
        huge_data_set,
        huge_labels,
    ],
    ids=lambda function: function.__name__,
)
def test_what_the_format_does_not_have_is_refused_unread(shard, tmp_path, put_in):
    read_all(shard)  # so that the process is there
    pid, odd = shards._DESCRIBER._process.pid, tmp_path / "odd.h5"
    with h5py.File(shard) as file, h5py.File(odd, "w", libver="latest") as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
        put_in(other)
    reset_peak(pid)
    before = peak_bytes(pid)
    refusal(odd)
    assert shards._DESCRIBER._process.pid == pid
    assert peak_bytes(pid) < before + 2**23


@pytest.mark.parametrize("name", ["tolerance_px", "symmetry_group"])
def test_attribute_that_hdf5_cannot_hold_in_the_memory_allowed_is_refused(shard, tmp_path, monkeypatch, name):
    """HDF5 reads the values of an array with what it says of them."""
    with h5py.File(shard) as file, h5py.File(tmp_path / "odd.h5", "w", libver="latest") as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
        other.attrs[name] = np.zeros((2**22, 3, 3))
    monkeypatch.setattr(shards, "_LIMITS", replace(shards._LIMITS, memory_bytes=2**29))
    with closing(shards._Describer()) as describer:
        monkeypatch.setattr(shards, "_DESCRIBER", describer)
        expected = read_all(shard)  # the limit suffices for a shard
        assert re.search("memory|allocat|damaged", refusal(tmp_path / "odd.h5"))
        assert set(read_all(shard)) == set(expected)


def test_text_of_an_attribute_has_a_limit(shard):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["versions"] = "x" * 2**24
    assert "attribute 'versions' is 16777216 characters, where a string belongs" in refusal(shard)


@pytest.mark.parametrize("name", LAYOUT)
def test_stream_that_is_longer_than_its_chunk_is_not_inflated(shard, name):
    bomb = zlib.compress(bytes(2**28))
    with h5py.File(shard, "r+") as file:
        file[name].id.write_direct_chunk((0,) * file[name].ndim, bomb + bytes(4))
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=r"found more|chunk lies outside the file, or is too large"):
            read_all(shard)
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


def test_deep_or_long_names_cost_little(shard):
    with h5py.File(shard, "r+", libver="latest") as file:
        for number in range(40):
            file["x" * 50_000 + str(number)] = np.zeros(1)
    assert len(refusal(shard)) < 40 * 200
