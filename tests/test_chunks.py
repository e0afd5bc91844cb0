"""Chunks read and made past HDF5: the same as HDF5's own, whatever the layout, and every damage an error."""

import os
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot import chunks
from symsol_annot.chunks import HDF5_ERRORS, ByteFile, Rows, fletcher32, identity_of, inflated, stored, whole
from symsol_annot.errors import DataError

COUNT, SHAPE = 4, (6, 5, 3)
ROW_BYTES = 90
AS_WRITTEN = {"chunks": (1, *SHAPE), "compression": "gzip", "fletcher32": True}
READ_BY_PLACE = {
    "as written": AS_WRITTEN,
    "gzip alone": {"chunks": (1, *SHAPE), "compression": "gzip"},
    "fletcher32 alone": {"chunks": (1, *SHAPE), "fletcher32": True},
    "no filter": {"chunks": (1, *SHAPE)},
    "shuffle": {**AS_WRITTEN, "shuffle": True},
    "gzip 9": {**AS_WRITTEN, "compression_opts": 9},
    "truth values": {**AS_WRITTEN, "dtype": "?"},
    "unlimited": {**AS_WRITTEN, "maxshape": (None, *SHAPE)},
}
READ_BY_HDF5 = {
    "contiguous": {},
    "one chunk": {**AS_WRITTEN, "chunks": (COUNT, *SHAPE)},
    "two rows a chunk": {**AS_WRITTEN, "chunks": (2, *SHAPE)},
    "half a row a chunk": {**AS_WRITTEN, "chunks": (1, 3, 5, 3)},
    "wide values": {**AS_WRITTEN, "dtype": "<u2"},
    "another filter": {"chunks": (1, *SHAPE), "compression": "lzf"},
}
LAYOUTS = READ_BY_PLACE | READ_BY_HDF5


def values_of(layout):
    values = np.random.default_rng(0).integers(256, size=(COUNT, *SHAPE), dtype=np.uint8)
    return (values % 3).astype(layout.get("dtype", "u1"))


def written(path, layout, **options):
    """A file with one data set; what h5py reads from it is returned."""
    with h5py.File(path, "w", **options) as file:
        file.create_dataset("image", data=values_of(layout), **layout)
    return all_by_h5py(path)


def all_by_h5py(path):
    with h5py.File(path) as file:
        return file["image"][...]


def rows_of(path):
    with h5py.File(path) as file:
        return Rows(file["image"])


def all_rows(path):
    rows, file = rows_of(path), ByteFile(path)
    return [rows.read(row, file) for row in range(COUNT)]


def assert_rows_are(path, expected):
    found = all_rows(path)
    assert [(row.dtype, row.shape) for row in found] == [(row.dtype, row.shape) for row in expected]
    np.testing.assert_array_equal(found, expected)


def chunk_of(path, row):
    with h5py.File(path) as file:
        return file["image"].id.get_chunk_info_by_coord((row, 0, 0, 0))


def put_chunk(path, row, data, mask=0):
    with h5py.File(path, "r+") as file:
        file["image"].id.write_direct_chunk((row, 0, 0, 0), data, mask)


@pytest.mark.parametrize("options", [{}, {"libver": "latest"}, {"userblock_size": 512}], ids=str)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_rows_are_those_that_h5py_reads(tmp_path, layout, options):
    expected = written(tmp_path / "a.h5", LAYOUTS[layout], **options)
    assert_rows_are(tmp_path / "a.h5", expected)


@pytest.mark.parametrize("layout", READ_BY_PLACE)
def test_hdf5_is_not_asked_for_a_row_of_a_layout_that_the_format_has(tmp_path, monkeypatch, layout):
    expected = written(tmp_path / "a.h5", LAYOUTS[layout])
    rows, file = rows_of(tmp_path / "a.h5"), ByteFile(tmp_path / "a.h5")
    monkeypatch.setattr(chunks.h5py, "File", lambda *_, **__: pytest.fail("HDF5 opened a file"))
    np.testing.assert_array_equal([rows.read(row, file) for row in range(COUNT)], expected)


def test_row_that_is_not_in_the_file_is_an_error_and_the_others_are_read(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("image", (COUNT, *SHAPE), "u1", **AS_WRITTEN)[2] = values_of({})[2]
    rows, file = rows_of(path), ByteFile(path)
    np.testing.assert_array_equal(rows.read(2, file), values_of({})[2])
    for row in (0, 1, 3):
        with pytest.raises(DataError, match=rf"a\.h5: row {row} cannot be read: image: the file's index is damaged"):
            rows.read(row, file)


@pytest.mark.parametrize("layout", [{}, {"chunks": (COUNT, 9)}, {"chunks": (3, 4), "compression": "gzip"}], ids=str)
def test_whole_is_what_h5py_reads_if_every_chunk_is_there(layout):
    values = np.arange(COUNT * 9.0).reshape(COUNT, 9)
    with h5py.File("whole", "w", driver="core", backing_store=False) as file:
        np.testing.assert_array_equal(whole(file.create_dataset("full", data=values, **layout)), values)
        if layout:
            with pytest.raises(ValueError, match="a chunk is missing"):
                whole(file.create_dataset("empty", values.shape, "f8", **layout))
            partly = file.create_dataset("partly", values.shape, "f8", chunks=(1, 9))
            partly[1:] = 1
            with pytest.raises(ValueError, match="a chunk is missing"):
                whole(partly)


@pytest.mark.parametrize("skipped", [0b00, 0b01, 0b10, 0b11])
def test_chunk_may_leave_out_filters(tmp_path, skipped):
    written(tmp_path / "a.h5", AS_WRITTEN)
    row = values_of({})[1] + 1
    data = row.tobytes() if skipped & 1 else zlib.compress(row.tobytes())
    put_chunk(tmp_path / "a.h5", 1, data if skipped & 2 else data + hdf5_checksum(data), skipped)
    expected = all_by_h5py(tmp_path / "a.h5")
    np.testing.assert_array_equal(expected[1], row)
    assert_rows_are(tmp_path / "a.h5", expected)


def test_row_is_a_new_array_that_may_be_written_to(tmp_path):
    for layout in LAYOUTS.values():
        expected = written(tmp_path / "a.h5", layout)
        rows, file = rows_of(tmp_path / "a.h5"), ByteFile(tmp_path / "a.h5")
        first = rows.read(0, file)
        assert first.flags.owndata
        assert first.flags.writeable
        first[...] = 9 if first.dtype != bool else ~first
        np.testing.assert_array_equal(rows.read(0, file), expected[0])


@pytest.mark.parametrize("layout", ["as written", "gzip alone"])
def test_flipped_bit_is_an_error_or_changes_nothing(tmp_path, layout):
    path = tmp_path / "a.h5"
    expected = written(path, LAYOUTS[layout])
    rows, file, chunk = rows_of(path), ByteFile(path), chunk_of(path, 2)
    data, unseen = path.read_bytes(), []
    with path.open("r+b", buffering=0) as changed:
        for bit in range(8 * chunk.size):
            place = chunk.byte_offset + bit // 8
            os.pwrite(changed.fileno(), bytes([data[place] ^ 1 << bit % 8]), place)
            try:
                np.testing.assert_array_equal(rows.read(2, file), expected[2])
                unseen.append(bit // 8)
            except DataError as error:
                assert f"{path}: row 2 cannot be read: image: " in str(error)  # noqa: PT017 - which bits are is open
            os.pwrite(changed.fileno(), data[place : place + 1], place)
    checksum = 4 if layout == "as written" else 0
    stream = [byte for byte in unseen if byte < chunk.size - checksum]
    assert len(unseen) - len(stream) == 8 * checksum  # fletcher32 is HDF5's to check
    assert len(stream) <= 7  # bits that pad the last byte before the adler32
    assert set(stream) <= {chunk.size - checksum - 5}


def test_flipped_bit_in_the_index_of_chunks_gives_the_right_row_or_an_error(tmp_path):
    path = tmp_path / "a.h5"
    expected = written(path, AS_WRITTEN)
    data = path.read_bytes()
    start = data.index(b"TREE\x01") + 24  # behind the node's head
    entry = 8 + 8 * 5 + 8  # size and filters, the offset in 4 dimensions and the type's, the address
    found = {"right": 0, "error": 0}
    with path.open("r+b", buffering=0) as changed:
        for bit in range(8 * start, 8 * (start + COUNT * entry)):
            os.pwrite(changed.fileno(), bytes([data[bit // 8] ^ 1 << bit % 8]), bit // 8)
            for row in range(COUNT):
                try:
                    np.testing.assert_array_equal(rows_of(path).read(row, ByteFile(path)), expected[row])
                    found["right"] += 1
                except (DataError, *HDF5_ERRORS):
                    found["error"] += 1
            os.pwrite(changed.fileno(), data[bit // 8 : bit // 8 + 1], bit // 8)
    assert min(found.values()) > 100


@pytest.mark.parametrize("layout", READ_BY_PLACE)
def test_row_beyond_the_end_of_a_file_is_an_error(tmp_path, layout):
    path = tmp_path / "a.h5"
    expected = written(path, LAYOUTS[layout])
    rows, file, chunk = rows_of(path), ByteFile(path), chunk_of(path, COUNT - 1)
    stored_end = chunk.byte_offset + chunk.size - (4 if LAYOUTS[layout].get("fletcher32") else 0)
    for end in (stored_end - 1, chunk.byte_offset, 100):
        os.truncate(path, end)
        with pytest.raises(DataError, match=rf"a\.h5: row {COUNT - 1} cannot be read: image: the file ends"):
            rows.read(COUNT - 1, file)
    with pytest.raises(DataError, match="row 0 cannot be read"):
        rows.read(0, file)
    assert len(expected) == COUNT


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (zlib.compress(bytes(ROW_BYTES - 1)), "expected a chunk of 90 bytes, found 89"),
        (zlib.compress(bytes(ROW_BYTES + 1)), "expected a chunk of 90 bytes, found more"),
        (zlib.compress(bytes(ROW_BYTES))[:-1], "found 90, or its end is missing"),
        (zlib.compress(b""), "found 0"),
        (bytes(ROW_BYTES), "decompressing"),
        (b"", "found 0"),
    ],
    ids=["short", "long", "cut", "empty", "no stream", "nothing"],
)
def test_chunk_of_a_wrong_length_is_an_error(tmp_path, data, words):
    path = tmp_path / "a.h5"
    expected = written(path, AS_WRITTEN)
    put_chunk(path, 1, data + hdf5_checksum(data))
    rows, file = rows_of(path), ByteFile(path)
    with pytest.raises(DataError, match=rf"a\.h5: row 1 cannot be read: image: .*{words}.*symsol-annot verify"):
        rows.read(1, file)
    np.testing.assert_array_equal(rows.read(2, file), expected[2])


def test_unfiltered_chunk_of_a_wrong_length_is_an_error(tmp_path):
    written(tmp_path / "a.h5", AS_WRITTEN)
    put_chunk(tmp_path / "a.h5", 1, bytes(ROW_BYTES + 1), 0b11)
    with pytest.raises(DataError, match="row 1 cannot be read"):
        rows_of(tmp_path / "a.h5").read(1, ByteFile(tmp_path / "a.h5"))


def test_deflate_bomb_is_refused_without_inflating_it(tmp_path):
    bomb = zlib.compress(bytes(2**28))
    written(tmp_path / "a.h5", AS_WRITTEN)
    put_chunk(tmp_path / "a.h5", 1, bomb + bytes(4))
    rows, file = rows_of(tmp_path / "a.h5"), ByteFile(tmp_path / "a.h5")
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match="expected a chunk of 90 bytes, found more"):
            rows.read(1, file)
        assert tracemalloc.get_traced_memory()[1] < 4 * len(bomb) < 2**28 // 100
    finally:
        tracemalloc.stop()


def test_damage_in_a_layout_that_hdf5_reads_is_the_same_error(tmp_path):
    path = tmp_path / "a.h5"
    written(path, READ_BY_HDF5["two rows a chunk"])
    chunk = chunk_of(path, 2)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"a\.h5: row 3 cannot be read: image: .*symsol-annot verify"):
        rows_of(path).read(3, ByteFile(path))


def test_file_of_another_shape_under_the_name_is_an_error_where_hdf5_reads(tmp_path):
    path = tmp_path / "a.h5"
    written(path, READ_BY_HDF5["contiguous"])
    rows = rows_of(path)
    with h5py.File(path, "w") as file:
        file["image"] = np.zeros((COUNT, 2, 2, 3), "u1")
    with pytest.raises(DataError, match=r"row 0 cannot be read: image: expected uint8 of shape \(6, 5, 3\)"):
        rows.read(0, ByteFile(path))


def test_file_stays_open_while_it_is_held_and_no_longer(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"0123456789")
    file, status = ByteFile(path), path.stat()
    descriptor = file._descriptor
    path.unlink()
    assert file.read(3, 4) == b"456"
    assert os.fstat(descriptor).st_ino == status.st_ino
    del file
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(descriptor)


def test_identity_is_the_files_and_not_its_names(tmp_path):
    written(tmp_path / "a.h5", AS_WRITTEN)
    written(tmp_path / "b.h5", AS_WRITTEN)
    a, b = ByteFile(tmp_path / "a.h5"), ByteFile(tmp_path / "b.h5")
    with h5py.File(tmp_path / "a.h5") as file:
        assert identity_of(file) == a.identity != b.identity
        (tmp_path / "b.h5").replace(tmp_path / "a.h5")
        assert identity_of(file) == a.identity != ByteFile(tmp_path / "a.h5").identity


def hdf5_checksum(data):
    """The four bytes that libhdf5 puts behind a chunk; for no data those of an empty sum."""
    if not data:
        return bytes(4)
    with h5py.File("checksum", "w", driver="core", backing_store=False) as file:
        dataset = file.create_dataset("bytes", (len(data),), "u1", chunks=(len(data),), fletcher32=True)
        dataset[...] = np.frombuffer(data, "u1")
        file.flush()
        whole = dataset.id.read_direct_chunk((0,))[1]
    assert whole[:-4] == data
    return whole[-4:]


@settings(deadline=None)
@given(st.binary(min_size=1, max_size=3000))
def test_fletcher32_is_hdf5s(data):
    assert fletcher32(data).to_bytes(4, "little") == hdf5_checksum(data)


@pytest.mark.parametrize("size", [1, 2, 3, 719, 720, 721, 131069, 131070, 131071, 131072, 400_001])
@pytest.mark.parametrize("fill", [0, 255, None])
def test_fletcher32_is_hdf5s_at_the_ends_of_its_blocks_and_of_its_modulus(size, fill):
    data = np.random.default_rng(size).bytes(size) if fill is None else bytes([fill]) * size
    assert fletcher32(data).to_bytes(4, "little") == hdf5_checksum(data)


@pytest.mark.parametrize("dtype", ["u1", "?", "<f4", "<f8"])
@pytest.mark.parametrize("shape", [(1, 6, 5, 3), (1, 1), (7,), (3, 100)])
def test_h5py_and_zlib_read_what_was_stored(dtype, shape):
    values = np.random.default_rng(0).integers(2, size=shape).astype(dtype)
    assert zlib.decompress(stored(values)[:-4]) == values.tobytes() == inflated(stored(values), values.nbytes)
    with h5py.File("stored", "w", driver="core", backing_store=False) as file:
        dataset = file.create_dataset("a", shape, dtype, chunks=shape, compression="gzip", fletcher32=True)
        dataset.id.write_direct_chunk([0] * len(shape), stored(values))
        np.testing.assert_array_equal(dataset[...], values)


def test_array_that_is_not_contiguous_is_stored_by_its_values():
    values = np.arange(24, dtype="u1").reshape(4, 6)
    assert stored(values.T) == stored(values.T.copy())
