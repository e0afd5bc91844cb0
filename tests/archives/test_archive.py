"""The archive of a set: the same bytes wherever it is packed, and what no archive of a set holds is refused."""

import io
import os
import shutil
import subprocess
import tarfile
from dataclasses import replace
from pathlib import Path

import pytest

from symsol_annot.archives import archive as archives
from symsol_annot.archives.archive import archive_blocks, read_archive
from symsol_annot.archives.fetching import fetch
from symsol_annot.errors import DataError
from symsol_annot.sets.manifest import read_manifest, write_manifest

MAX_BYTES = 2**24  # of a manifest


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def tar_of(files, tar_format=tarfile.USTAR_FORMAT):
    """A tar file of names and bytes, or of names and headers without bytes."""
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w", format=tar_format) as tar:
        for name, content in files:
            header = content if isinstance(content, tarfile.TarInfo) else tarfile.TarInfo(name)
            if isinstance(content, tarfile.TarInfo):
                tar.addfile(header)
                continue
            header.size = len(content)
            tar.addfile(header, io.BytesIO(content))
    return data.getvalue()


def files_of(folder):
    return [(f"tetX/{path.name}", path.read_bytes()) for path in sorted(folder.iterdir())]


def test_an_archive_is_what_tarfile_makes_of_sorted_names_without_times_and_owners(packed_set, archive):
    assert archive.read_bytes() == tar_of(files_of(packed_set))


def test_the_same_set_gives_the_same_bytes_whatever_its_times_and_modes_are(packed_set, archive, tmp_path):
    copy = Path(shutil.copytree(packed_set, tmp_path / "elsewhere"))
    for path in copy.iterdir():
        os.utime(path, (1, 1))
        path.chmod(0o600)
    assert b"".join(archive_blocks(copy, "tetX")) == archive.read_bytes()


def test_tar_unpacks_it_and_takes_it_for_whole(packed_set, archive, tmp_path):
    subprocess.run(["tar", "-xf", archive, "-C", tmp_path], check=True)
    assert contents(tmp_path / "tetX") == contents(packed_set)


@pytest.mark.parametrize("options", [["--format=ustar"], ["--format=gnu"], ["--format=v7"]], ids=str)
def test_an_archive_that_tar_made_of_the_folder_is_taken(packed_set, tmp_path, options):
    packing = ["tar", *options, "-cf", tmp_path / "mine.tar", "-C", packed_set.parent, "tetX"]
    subprocess.run(packing, check=True)
    fetched = fetch(str(tmp_path / "mine.tar"), tmp_path / "data")
    assert fetched.folder == tmp_path / "data" / "tetX"
    assert contents(fetched.folder) == contents(packed_set)


def entry(name, kind, target=""):
    header = tarfile.TarInfo(name)
    header.type, header.linkname = kind, target
    return name, header


HOSTILE = {
    "a path upwards": (("../escaped.h5", b"x"), "outside of the set's folder"),
    "a path upwards from the set": (("tetX/../../escaped.h5", b"x"), "outside of the set's folder"),
    "a path from the root": (("/tmp/escaped.h5", b"x"), "outside of the set's folder"),
    "a path upwards as Windows has them": (("tetX\\..\\..\\escaped.h5", b"x"), "outside of the set's folder"),
    "a symbolic link": (entry("tetX/test.h5", tarfile.SYMTYPE, "/etc/passwd"), "holds a symbolic link"),
    "a link": (entry("tetX/test.h5", tarfile.LNKTYPE, "/etc/passwd"), "holds a link"),
    "a character device": (entry("tetX/test.h5", tarfile.CHRTYPE), "holds a device"),
    "a block device": (entry("tetX/test.h5", tarfile.BLKTYPE), "holds a device"),
    "a pipe": (entry("tetX/test.h5", tarfile.FIFOTYPE), "holds a pipe"),
    "a folder in the set": (entry("tetX/inner", tarfile.DIRTYPE), "holds a folder"),
    "a sparse file": (entry("tetX/test.h5", tarfile.GNUTYPE_SPARSE), "an extension of tar"),
    "a file in a folder in the set": (("tetX/inner/test.h5", b"x"), "no file of a set"),
    "a file without a folder": (("manifest.json", b"{}"), "no file of a set"),
    "a hidden folder": ((".ssh/authorized_keys", b"x"), "no file of a set"),
    "a file that is no shard": (("tetX/.bashrc", b"x"), "no part of its set: '.bashrc'"),
    "a file of another set": (("cylO/manifest.json", b"{}"), "has cylO, tetX, where one set's folder belongs"),
    "a file twice": (("tetX/manifest.json", b"{}"), "twice"),
    "a name that acts on a terminal": (("tetX/\x1b[2J", b"x"), r"'\\x1b\[2J'"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_an_archive_with_something_that_no_set_has_is_refused_and_nothing_is_written(packed_set, tmp_path, what):
    added, message = HOSTILE[what]
    for number, files in enumerate(([added, *files_of(packed_set)], [*files_of(packed_set), added])):
        path = tmp_path / f"{number}.tar"
        path.write_bytes(tar_of(files))
        with pytest.raises(DataError, match=message) as refused:
            fetch(str(path), tmp_path / "data")
        assert str(path) in str(refused.value)
        assert str(refused.value).isprintable()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.tar", "1.tar"]
    assert not Path("/tmp/escaped.h5").exists()


def test_extensions_that_rename_or_resize_files_are_refused(packed_set, tmp_path):
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w", format=tarfile.PAX_FORMAT, pax_headers={"path": "../escaped"}) as tar:
        tar.add(packed_set, "tetX")
    (tmp_path / "pax.tar").write_bytes(data.getvalue())
    with pytest.raises(DataError, match=r"an extension of tar.*--format=ustar"):
        fetch(str(tmp_path / "pax.tar"), tmp_path / "data")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("size", [-1, 2**40])
def test_a_size_that_no_file_has_is_refused(packed_set, size):
    header = tarfile.TarInfo("tetX/manifest.json")
    header.size = size
    file = io.BytesIO(header.tobuf(tarfile.GNU_FORMAT) + bytes(1024))
    with pytest.raises(DataError, match="cut short, or damaged"):
        read_archive(file, "it")


def test_a_manifest_larger_than_any_is_refused():
    with pytest.raises(DataError, match=r"manifest\.json is larger than"):
        read_archive(io.BytesIO(tar_of([("tetX/manifest.json", bytes(MAX_BYTES + 1))])), "it")


def test_more_files_than_a_set_has_are_refused(monkeypatch):
    assert archives._MAX_MEMBERS > 50_000  # shards, which a manifest of the largest size lists
    monkeypatch.setattr(archives, "_MAX_MEMBERS", 1000)
    block = b"".join(tarfile.TarInfo(f"tetX/{number}").tobuf() for number in range(1001))
    with pytest.raises(DataError, match="holds more than 1,000 files"):
        read_archive(io.BytesIO(block + bytes(1024)), "it")


def test_an_archive_that_is_cut_anywhere_is_refused(archive):
    data = archive.read_bytes()
    for length in (0, 1, 511, 512, 700, len(data) // 3, len(data) // 2, len(data) - 10_241):
        with pytest.raises(DataError, match=r"^it: (is cut short|is no tar file)"):
            read_archive(io.BytesIO(data[:length]), "it")


def test_a_bit_that_flips_anywhere_is_found(archive, tmp_path):
    """In a header, in the manifest, in a shard: without the archive's digest, the set's own say so."""
    data = archive.read_bytes()
    for place in (0, 150, 600, 2000, len(data) // 2, len(data) - 12_000):
        damaged = bytearray(data)
        damaged[place] ^= 1
        (tmp_path / "damaged.tar").write_bytes(damaged)
        with pytest.raises(DataError, match=r"damaged\.tar"):
            fetch(str(tmp_path / "damaged.tar"), tmp_path / "data")
        assert not (tmp_path / "data").exists()


def test_a_set_that_lacks_a_shard_or_was_never_finished_is_refused(packed_set, tmp_path):
    (tmp_path / "lacking.tar").write_bytes(tar_of(files_of(packed_set)[:-1]))
    with pytest.raises(DataError, match=r"lacks shards of its set: train-00000-of-00001\.h5"):
        fetch(str(tmp_path / "lacking.tar"), tmp_path / "data")
    begun = Path(shutil.copytree(packed_set, tmp_path / "tetX"))
    manifest = read_manifest(begun)
    write_manifest(
        begun, manifest.with_finished(replace(manifest.shards[0], bytes=None, sha256=None, content_sha256=None))
    )
    (tmp_path / "begun.tar").write_bytes(tar_of(files_of(begun)))
    with pytest.raises(DataError, match="not finished"):
        fetch(str(tmp_path / "begun.tar"), tmp_path / "data")
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"<html>not here</html>" * 100, "is no tar file.*in a browser"),
        (b"", "is no tar file"),
        (bytes(10_240), "holds no files"),
        (tar_of([("tetX/test-00000-of-00001.h5", b"x")]), r"holds no tetX/manifest\.json"),
        (tar_of([("tetX/manifest.json", b"[" * 10_000)]), "cannot be read as JSON"),
        (tar_of([("tetX/manifest.json", b"{}")]), "is no manifest of a set"),
    ],
)
def test_what_is_no_archive_of_a_set_is_named(data, message):
    with pytest.raises(DataError, match=rf"^it: .*{message}"):
        read_archive(io.BytesIO(data), "it")
