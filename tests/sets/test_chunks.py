"""Chunks read and made past HDF5: the same as HDF5's own, and every damage an error."""

import hashlib
import os
import tracemalloc
import zlib

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.errors import DamageError
from symsol_annot.sets.shard.chunks import ByteFile, Place, StoredArray, fletcher32, inflated, largest_chunk, stored

COUNT, SHAPE = 4, (6, 5, 3)
ROW_BYTES = 90
AS_WRITTEN = {"chunks": (1, *SHAPE), "compression": "gzip", "fletcher32": True}
LAYOUTS = {
    "as written": AS_WRITTEN,
    "gzip 9": {**AS_WRITTEN, "compression_opts": 9},
    "gzip 0": {**AS_WRITTEN, "compression_opts": 0},
    "truth values": {**AS_WRITTEN, "dtype": "?"},
    "floats": {**AS_WRITTEN, "dtype": "<f8"},
    "unlimited": {**AS_WRITTEN, "maxshape": (None, *SHAPE)},
    "all rows in one chunk": {**AS_WRITTEN, "chunks": (COUNT, *SHAPE)},
    "two rows per chunk": {**AS_WRITTEN, "chunks": (2, *SHAPE)},
}
ROW_PER_CHUNK = [name for name, layout in LAYOUTS.items() if layout["chunks"][0] == 1]


def values_of(layout):
    values = np.random.default_rng(0).integers(256, size=(COUNT, *SHAPE), dtype=np.uint8)
    return (values % 3).astype(layout.get("dtype", "u1"))


def written(path, layout=AS_WRITTEN, **options):
    """Write a file with one data set; what h5py reads from it is returned."""
    with h5py.File(path, "w", **options) as file:
        file.create_dataset("image", data=values_of(layout), **layout)
    with h5py.File(path) as file:
        return file["image"][...]


def array_of(path):
    """Return the data set's places as HDF5 tells them, which is what a shard's are made from."""
    with h5py.File(path) as file:
        rows = file["image"]
        chunks = [rows.id.get_chunk_info(number) for number in range(rows.id.get_num_chunks())]
        places = tuple(Place(c.byte_offset, c.size) for c in sorted(chunks, key=lambda chunk: chunk.chunk_offset))
        return StoredArray("image", rows.shape, rows.dtype.str, rows.chunks[0], places)


def opened(path):
    return array_of(path), ByteFile(path)


def put_chunk(path, row, data):
    with h5py.File(path, "r+") as file:
        file["image"].id.write_direct_chunk((row, 0, 0, 0), data)


@pytest.mark.parametrize("options", [{}, {"libver": "latest"}], ids=str)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_read_is_what_h5py_reads(tmp_path, layout, options):
    expected = written(tmp_path / "a.h5", LAYOUTS[layout], **options)
    array, file = opened(tmp_path / "a.h5")
    found = [array.whole(file)]
    if layout in ROW_PER_CHUNK:
        found.append(np.stack([array.row(row, file) for row in range(COUNT)]))
    for values in found:
        assert (values.dtype, values.shape) == (expected.dtype, expected.shape)
        np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize("layout", ROW_PER_CHUNK)
def test_row_is_a_new_array_that_may_be_written_to(tmp_path, layout):
    expected = written(tmp_path / "a.h5", LAYOUTS[layout])
    array, file = opened(tmp_path / "a.h5")
    for read, there in ((lambda: array.row(0, file), expected[0]), (lambda: array.whole(file), expected)):
        first = read()
        assert first.flags.writeable
        first[...] = 9 if first.dtype != bool else ~first
        np.testing.assert_array_equal(read(), there)


def test_flipped_bit_is_an_error_or_changes_nothing(tmp_path):
    path = tmp_path / "a.h5"
    expected = written(path)
    array, file = opened(path)
    place, data, unseen = array.places[2], path.read_bytes(), []
    with path.open("r+b", buffering=0) as changed:
        for bit in range(8 * place.size):
            byte = place.offset + bit // 8
            os.pwrite(changed.fileno(), bytes([data[byte] ^ 1 << bit % 8]), byte)
            try:
                np.testing.assert_array_equal(array.row(2, file), expected[2])
                unseen.append(bit // 8)
            except DamageError as error:
                assert "row 2 cannot be read: image: " in str(error)  # noqa: PT017 - which bits are is open
            os.pwrite(changed.fileno(), data[byte : byte + 1], byte)
    stream = [byte for byte in unseen if byte < place.size - 4]
    assert len(unseen) - len(stream) == 8 * 4  # fletcher32, which the file's SHA-256 stands in for
    assert len(stream) <= 7  # bits that pad the last byte before the adler32
    assert set(stream) <= {place.size - 4 - 5}


@pytest.mark.parametrize("layout", ROW_PER_CHUNK)
def test_row_beyond_the_end_of_a_file_is_an_error(tmp_path, layout):
    path = tmp_path / "a.h5"
    written(path, LAYOUTS[layout])
    array, file = opened(path)
    last = array.places[COUNT - 1]
    for end in (last.offset + last.size - 5, last.offset, 100):
        os.truncate(path, end)
        with pytest.raises(DamageError, match=f"row {COUNT - 1} cannot be read: image: the file ends .* too early"):
            array.row(COUNT - 1, file)
    for read in (lambda: array.row(0, file), lambda: array.whole(file)):
        with pytest.raises(DamageError, match="row 0 cannot be read"):
            read()


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
    expected = written(path)
    put_chunk(path, 1, data + hdf5_checksum(data))
    array, file = opened(path)
    with pytest.raises(DamageError, match=rf"row 1 cannot be read: image: .*{words}"):
        array.row(1, file)
    np.testing.assert_array_equal(array.row(2, file), expected[2])


def test_deflate_bomb_is_refused_without_inflating_it(tmp_path):
    bomb = zlib.compress(bytes(2**28))
    written(tmp_path / "a.h5")
    put_chunk(tmp_path / "a.h5", 1, bomb + bytes(4))
    array, file = opened(tmp_path / "a.h5")
    tracemalloc.start()
    try:
        with pytest.raises(DamageError, match="expected a chunk of 90 bytes, found more"):
            array.row(1, file)
        assert tracemalloc.get_traced_memory()[1] < 4 * len(bomb) < 2**28 // 100
    finally:
        tracemalloc.stop()


def test_truth_value_is_0_or_1(tmp_path):
    """A byte of 2 counts as true in numpy and as 2 in a sum."""
    written(tmp_path / "a.h5", LAYOUTS["truth values"])
    for byte in (2, 128, 255):
        put_chunk(tmp_path / "a.h5", 1, stored(np.full((1, *SHAPE), byte, "u1")))
        array, file = opened(tmp_path / "a.h5")
        with pytest.raises(DamageError, match="image cannot be read: it holds other bytes than 0 and 1"):
            array.row(1, file)
        with pytest.raises(DamageError, match="image cannot be read: it holds other bytes than 0 and 1"):
            array.whole(file)
        assert array.row(0, file).dtype == bool


@settings(deadline=None)
@given(st.binary(min_size=1, max_size=20_000))
def test_no_chunk_of_ours_is_larger_than_is_allowed(data):
    assert len(stored(np.frombuffer(data, "u1"))) <= largest_chunk(len(data))


def test_no_chunk_of_noise_is_larger_than_is_allowed():
    for size in (1, 100, 2**16, 2**20):
        noise = np.random.default_rng(0).bytes(size)
        for level in range(10):
            assert len(zlib.compress(noise, level)) + 4 <= largest_chunk(size)


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
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(b"same")
    a, b = ByteFile(tmp_path / "a"), ByteFile(tmp_path / "b")
    (tmp_path / "link").symlink_to("a")
    assert ByteFile(tmp_path / "link").identity == a.identity != b.identity
    (tmp_path / "b").replace(tmp_path / "a")
    assert ByteFile(tmp_path / "a").identity == b.identity


def test_identity_is_anothers_once_the_file_grew(tmp_path):
    (tmp_path / "a").write_bytes(b"same")
    before = ByteFile(tmp_path / "a").identity
    with (tmp_path / "a").open("ab") as file:
        file.write(b"!")
    assert ByteFile(tmp_path / "a").identity != before


@pytest.mark.parametrize("size", [0, 1, 2**20 - 1, 2**20, 2**20 + 1, 3 * 2**20 + 5])
def test_digest_of_a_file_is_the_sha256_of_all_its_bytes(tmp_path, size):
    data = np.random.default_rng(size).bytes(size)
    (tmp_path / "a").write_bytes(data)
    assert ByteFile(tmp_path / "a").sha256() == hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize("kind", ["fifo", "device", "folder", "link to a device"])
def test_what_is_no_regular_file_is_refused_and_not_waited_for(tmp_path, kind):
    path = tmp_path / "a"
    {
        "fifo": lambda: os.mkfifo(path),
        "device": lambda: path.symlink_to("/dev/null"),
        "folder": path.mkdir,
        "link to a device": lambda: path.symlink_to("/dev/zero"),
    }[kind]()
    with pytest.raises(OSError, match=r"is no regular file|is a folder"):
        ByteFile(path)


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
