"""Publishing sets: the bytes, what a run keeps of the one before it, and what data are refused."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bundles import assert_refused, assert_whole, snapshot

from symsol_annot.archives.fetching import fetch
from symsol_annot.errors import DataError
from symsol_annot.publish import publication
from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
from symsol_annot.sets.verify import verify


def test_the_shards_of_a_bundle_are_the_sets(bundle, data):
    for name in ("cylO", "tet", "tetX"):
        assert snapshot(bundle / "data" / name) == snapshot(data / name)
        assert verify(bundle / "data" / name) == []


def test_the_same_data_give_the_same_bytes_from_any_place(bundle, data, tmp_path):
    copied = Path(shutil.copytree(data, tmp_path / "elsewhere"))
    publish(sets_in(copied), tmp_path / "again", About())
    assert snapshot(tmp_path / "again") == snapshot(bundle)


def test_again_changes_nothing_and_encodes_nothing(data, tmp_path, monkeypatch):
    out = tmp_path / "bundle"
    publish(sets_in(data / "tetX"), out, About())
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in out.rglob("*")}
    monkeypatch.setattr(publication, "samples_to_parquet", None)
    publish(sets_in(data / "tetX"), out, About())
    assert {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in out.rglob("*")} == before


def test_a_finished_list_of_checksums_is_gone_while_the_bundle_is_changed(data, tmp_path, monkeypatch):
    out, seen = tmp_path / "bundle", []
    publish(sets_in(data / "tetX"), out, About())

    def stopped(*_):
        seen.append(sorted(path.name for path in out.glob("SHA256SUMS*")))
        raise KeyboardInterrupt

    monkeypatch.setattr(publication, "card", stopped)
    with pytest.raises(KeyboardInterrupt):
        publish(sets_in(data / "tetX"), out, About(title="Others"))
    assert seen == [["SHA256SUMS.unfinished"]]
    assert not (out / "SHA256SUMS").exists()
    monkeypatch.undo()
    publish(sets_in(data / "tetX"), out, About(title="Others"))
    assert_whole(out)


def test_another_title_rewrites_the_descriptions_alone(data, tmp_path):
    out = tmp_path / "bundle"
    publish(sets_in(data / "tetX"), out, About())
    before = snapshot(out)
    publish(sets_in(data / "tetX"), out, About(title="Others"))
    after = snapshot(out)
    changed = {name for name in before if before[name] != after[name]}
    assert set(before) == set(after)
    assert changed == {"README.md", "dataset_card.md", "croissant.json", "CITATION.cff", "SHA256SUMS"}


KILLED = """
import os, sys
from pathlib import Path
from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
steps = iter(range(int(sys.argv[3])))
publish(sets_in(Path(sys.argv[1])), Path(sys.argv[2]), About(), lambda: next(steps, None) is None and os._exit(9))
"""


def test_a_killed_run_is_gone_on_with_and_what_it_made_is_kept(data, tmp_path):
    out, whole = tmp_path / "bundle", tmp_path / "whole"
    shards = len(sets_in(data / "tetX")[0].manifest.shards)
    done = subprocess.run([sys.executable, "-c", KILLED, data / "tetX", out, str(shards + 2)], check=False)
    assert done.returncode == 9
    assert not (out / "SHA256SUMS").exists()
    made = {path: path.stat().st_ino for path in out.rglob("*.parquet")}
    assert 0 < len(made) < shards
    publish(sets_in(data / "tetX"), out, About())
    publish(sets_in(data / "tetX"), whole, About())
    assert snapshot(out) == snapshot(whole)
    assert {path: path.stat().st_ino for path in made} == made


def test_a_damaged_shard_is_named_and_nothing_is_published(tetX_set, tmp_path):
    for shard in ("test-00001-of-00003.h5", "test-00002-of-00003.h5"):
        damaged = bytearray((tetX_set / shard).read_bytes())
        damaged[len(damaged) // 2] ^= 1
        (tetX_set / shard).write_bytes(damaged)
    assert_refused(
        tetX_set, tmp_path / "out", DataError, "test-00001-of-00003.h5", "test-00002-of-00003.h5", "--repair"
    )
    assert not (tmp_path / "out").exists()


def test_a_shard_that_changes_meanwhile_is_not_published(tetX_set, tmp_path):
    shards, calls = sorted(tetX_set.glob("test-*.h5")), []

    def change_after_verifying():
        calls.append(1)
        if len(calls) == 4:  # all are verified
            shards[0].write_bytes(shards[1].read_bytes())

    with pytest.raises(DataError, match=r"changed while it was published|no shard of this set"):
        publish(sets_in(tetX_set), tmp_path / "out", About(), change_after_verifying)
    assert not (tmp_path / "out" / "data" / "tetX" / shards[0].name).exists()


def test_each_set_has_an_archive_that_its_digest_and_fetch_accept(bundle, data, tmp_path):
    for name in ("cylO", "tet", "tetX"):
        digest = f"{name}.tar.sha256"
        subprocess.run(["sha256sum", "-c", "--strict", "--status", digest], cwd=bundle / "archives", check=True)
        fetched = fetch(str(bundle / "archives" / f"{name}.tar"), tmp_path)
        assert snapshot(fetched.folder) == snapshot(data / name)
        assert f"{fetched.sha256}  archives/{name}.tar" in (bundle / "SHA256SUMS").read_text()
