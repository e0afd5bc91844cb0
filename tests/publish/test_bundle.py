"""The folder that is published into: whole, listed, and nobody else's files touched."""

import errno
import os
import re

import pytest
from bench_sets import SmallDisk
from bundles import assert_refused, assert_whole, snapshot
from made_sets import make_set

from symsol_annot.errors import OutputError
from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
from symsol_annot.sets.verify import verify


def test_sha256sum_accepts_the_list_and_it_names_every_file(bundle):
    assert_whole(bundle)
    first, *lines = (bundle / "SHA256SUMS").read_text().splitlines()
    assert first == "# made by `symsol-annot publish`"
    listed = [line[66:] for line in lines]
    assert sorted([*listed, "SHA256SUMS"]) == sorted(snapshot(bundle))


def test_shards_are_links_or_copies_where_links_cannot_be(data, tmp_path, monkeypatch):
    publish(sets_in(data / "tetX"), tmp_path / "links", About())
    assert (tmp_path / "links/data/tetX/test-00000-of-00003.h5").samefile(data / "tetX/test-00000-of-00003.h5")

    def no_links(*_):
        raise OSError(errno.EXDEV, "another disk")

    monkeypatch.setattr(os, "link", no_links)
    publish(sets_in(data / "tetX"), tmp_path / "copies", About())
    assert not (tmp_path / "copies/data/tetX/test-00000-of-00003.h5").samefile(data / "tetX/test-00000-of-00003.h5")
    assert snapshot(tmp_path / "copies") == snapshot(tmp_path / "links")


@pytest.mark.parametrize("name", ["notes.txt", "README.md", "data/tetX/mine.h5", "SHA256SUMS"])
def test_a_folder_that_holds_somebody_elses_files_is_not_touched(data, tmp_path, name):
    (tmp_path / "out" / name).parent.mkdir(parents=True)
    (tmp_path / "out" / name).write_text("mine")
    assert_refused(data, tmp_path / "out", OutputError, name, "--out")


@pytest.mark.parametrize("text", ["", f"{'0' * 64}  README.md\n", f"{'0' * 64}  thesis.pdf\n", "# mine\n"])
@pytest.mark.parametrize("name", ["SHA256SUMS", "SHA256SUMS.unfinished"])
def test_a_list_of_somebody_elses_checksums_makes_no_bundle_of_a_folder(data, tmp_path, name, text):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text(text)
    assert_refused(data, tmp_path / "out", OutputError, name)


@pytest.mark.parametrize("name", ["README.md", "parquet/tetX/test-00000-of-00003.parquet"])
def test_a_file_of_the_bundle_that_became_a_link_is_left_as_it_is(data, tmp_path, name):
    """As git-annex keeps large files."""
    out = tmp_path / "out"
    publish(sets_in(data / "tetX"), out, About())
    (out / name).rename(tmp_path / "elsewhere")
    (out / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="holds links in place of files"):
        publish(sets_in(data / "tetX"), out, About())
    assert (out / name).is_symlink()


def test_a_file_of_the_bundle_that_is_changed_meanwhile_is_left_as_it_is(data, tmp_path):
    out, calls = tmp_path / "out", []
    publish(sets_in(data / "tetX"), out, About(title="before"))

    def edit_after_opening():
        if not calls:
            (out / "README.md").write_text("mine")
        calls.append(1)

    with pytest.raises(OutputError, match=r"was changed while this command ran: README\.md"):
        publish(sets_in(data / "tetX"), out, About(title="after"), edit_after_opening)
    assert (out / "README.md").read_text() == "mine"


def test_what_is_hidden_in_the_folder_stays(data, tmp_path):
    """At any depth, there before or put there since."""
    out = tmp_path / "out"
    for name in (".cache/notes", "data/.DS_Store", "data/tetX/.cache/notes", "parquet/tetX/.x.h5"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("of who uploads")
        publish(sets_in(data / "tetX"), out, About())
        publish(sets_in(data / "tetX"), out, About())
        assert (out / name).read_text() == "of who uploads"
    assert not re.search(r"(  |/)\.", (out / "SHA256SUMS").read_text())
    assert_whole(out)


def test_the_folder_of_the_sets_itself_is_not_published_into(data):
    assert_refused(data, data, OutputError, "no part of this bundle")


def test_a_card_that_was_edited_is_not_overwritten(data, tmp_path):
    out = tmp_path / "out"
    publish(sets_in(data / "tetX"), out, About())
    (out / "README.md").write_text("much better")
    assert_refused(data / "tetX", out, OutputError, "changed since they were made: README.md")
    (out / "README.md").unlink()
    publish(sets_in(data / "tetX"), out, About())
    assert (out / "README.md").read_bytes() == (out / "dataset_card.md").read_bytes()


def test_the_bundle_of_another_set_is_not_overwritten(data, tmp_path):
    out = tmp_path / "out"
    other = make_set(tmp_path / "other", train=5, test=40, seed=1)
    publish(sets_in(data / "tetX"), out, About())
    assert_refused(other, out, OutputError, "of another set", "data/tetX/manifest.json")
    assert_refused(data / "cylO", out, OutputError, "no part of this bundle")


def test_a_link_out_of_the_folder_is_refused(data, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "data").symlink_to(tmp_path / "elsewhere")
    assert_refused(data / "tetX", tmp_path / "out", OutputError, "data")
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_a_full_disk_is_said_and_the_same_command_goes_on(data, tmp_path):
    """A real one, on which shards can be no links either."""
    (tmp_path / "disk").mkdir()
    disk, out = SmallDisk(tmp_path / "disk"), tmp_path / "disk" / "out"
    try:
        disk.resize(160)
        with pytest.raises(OutputError, match="the disk is full"):
            publish(sets_in(data / "tetX"), out, About())
        assert list(out.rglob("*.h5"))
        assert not (out / "SHA256SUMS").exists()
        disk.resize(4096)
        publish(sets_in(data / "tetX"), out, About())
        assert_whole(out)
        assert verify(out / "data" / "tetX") == []
    finally:
        disk.unmount()
