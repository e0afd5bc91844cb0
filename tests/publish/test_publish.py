"""Publishing: what comes out is loaded back with the libraries it is for, and every sample compared with the set's."""

import errno
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

os.environ |= {"HF_HUB_OFFLINE": "1", "HF_DATASETS_DISABLE_PROGRESS_BARS": "1"}  # read when they are imported

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from bench_sets import SmallDisk, run, small_set
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_sets import make_set
from PIL import Image

import symsol_annot
from symsol_annot.errors import DataError, OutputError, SettingsError
from symsol_annot.publish import parquet, publication
from symsol_annot.publish.about import About
from symsol_annot.publish.card import _size_category
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.settings import ImportedSettings, Source
from symsol_annot.sets.verify import verify
from symsol_annot.system.png import to_png

ROOT = Path(__file__).parents[2]
SPLITS = [("cylO", "test"), ("tet", "train"), ("tetX", "train"), ("tetX", "test")]  # tetX's train has no sets
COMMAND = (sys.executable, "-c", "from symsol_annot_cli.main import main; main()", "publish")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Sets of a marked round body, an unmarked one, and one of which a split has no symmetry sets."""
    folder = tmp_path_factory.mktemp("sets") / "data"
    small_set(folder, "cylO", images=4)
    make_set(folder, "tet", train=110, test=0, annotate="all")  # a shard of more than a row group
    make_set(folder, "tetX", train=5, test=40)
    return folder


@pytest.fixture(scope="module")
def bundle(data, tmp_path_factory):
    """Not to be written to."""
    out = tmp_path_factory.mktemp("published") / "bundle"
    publish(sets_in(data), out, About())
    return out


@pytest.fixture
def no_network(monkeypatch):
    def refuse(*_):
        raise AssertionError("the network was asked")

    monkeypatch.setattr("socket.socket.connect", refuse)
    monkeypatch.setattr("socket.getaddrinfo", refuse)


def snapshot(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_same(row, sample):
    """A row of any mirror is the sample: types, bits, entries."""
    image, segmentation = row["image"], row["segmentation"]
    assert (image.mode, segmentation.mode) == ("RGB", "L")
    assert np.array_equal(np.asarray(image), sample.image)
    assert np.array_equal(np.asarray(segmentation), sample.segmentation)
    rotation = np.array(row["rotation"])
    assert rotation.dtype == np.float64
    assert rotation.tobytes() == sample.rotation.tobytes()
    if sample.symmetry_mask is None:
        assert row["symmetry_mask"] is None
    else:
        mask = np.array(row["symmetry_mask"])
        assert mask.dtype == bool
        assert np.array_equal(mask, sample.symmetry_mask)
    assert row["index"] == sample.index
    assert np.float32(row["marking_pixels"]) == np.float32(sample.marking_pixels)
    assert row["marking_visible"] is sample.marking_visible


def assert_all_same(rows, samples):
    assert len(rows) == len(samples)
    for row, sample in zip(rows, samples, strict=True):
        assert_same(row, sample)


@pytest.mark.parametrize(("name", "split"), SPLITS)
def test_datasets_reads_every_sample_offline(bundle, data, tmp_path, no_network, name, split):
    import datasets

    rows = datasets.load_dataset(str(bundle), name, split=split, cache_dir=str(tmp_path))
    assert rows.features["image"] == rows.features["segmentation"] == datasets.Image()
    assert rows.features["rotation"] == datasets.List(datasets.List(datasets.Value("float64")))
    assert_all_same(rows, symsol_annot.load(data / name, split))


def test_datasets_reads_the_groups_and_lists_every_set_and_split(bundle, data, tmp_path, no_network):
    import datasets

    rows = datasets.load_dataset(str(bundle), "symmetry_groups", split="train", cache_dir=str(tmp_path))
    groups = {row["set"]: np.array(row["symmetry_group"]) for row in rows}
    assert set(groups) == {"cylO", "tet", "tetX"}
    for name, split in SPLITS:
        assert groups[name].tobytes() == symsol_annot.load(data / name, split).symmetry_group.tobytes()
    assert datasets.get_dataset_config_names(str(bundle)) == ["cylO", "tet", "tetX", "symmetry_groups"]
    assert datasets.get_dataset_split_names(str(bundle), "tetX") == ["train", "test"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib")
@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_mlcroissant_validates_and_reads_every_record_offline(bundle, data, tmp_path, no_network):
    import mlcroissant

    croissant = mlcroissant.Dataset(jsonld=bundle / "croissant.json")
    assert not croissant.metadata.ctx.issues.errors
    assert [warning for warning in croissant.metadata.ctx.issues.warnings if "datePublished" not in warning] == []
    for name, split in SPLITS:
        records = list(croissant.records(f"{name}_{split}"))
        rows = [{field.partition("/")[2]: value for field, value in record.items()} for record in records]
        assert_all_same(rows, symsol_annot.load(data / name, split))
    groups = {record["symmetry_groups/set"]: record for record in croissant.records("symmetry_groups")}
    for name, split in SPLITS:
        group = np.array(groups[name.encode()]["symmetry_groups/symmetry_group"])
        assert group.tobytes() == symsol_annot.load(data / name, split).symmetry_group.tobytes()


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_with_a_date_and_a_url_croissant_has_nothing_to_say(data, tmp_path):
    import mlcroissant

    about = About("Tests", ("A. Person", 'The "Group"'), "2.1.0", "2026-01-31", "https://example.org/data")
    publish(sets_in(data / "cylO"), tmp_path / "bundle", about)
    croissant = mlcroissant.Dataset(jsonld=tmp_path / "bundle" / "croissant.json")
    assert not croissant.metadata.ctx.issues.errors | croissant.metadata.ctx.issues.warnings
    assert croissant.metadata.date_published.date().isoformat() == "2026-01-31"
    citation = yaml.safe_load((tmp_path / "bundle" / "CITATION.cff").read_text())
    assert citation["authors"] == [{"name": "A. Person"}, {"name": 'The "Group"'}]
    assert (citation["url"], citation["version"]) == ("https://example.org/data", "2.1.0")
    assert '{A. Person} and {The "Group"}' in (tmp_path / "bundle" / "README.md").read_text()


def test_pyarrow_alone_reads_every_sample(bundle, data):
    for name, split in SPLITS:
        samples = symsol_annot.load(data / name, split)
        paths = sorted((bundle / "parquet" / name).glob(f"{split}-*.parquet"))
        rows = [row for path in paths for row in pq.read_table(path).to_pylist()]
        for row in rows:
            row |= {key: Image.open(io.BytesIO(row[key]["bytes"])) for key in ("image", "segmentation")}
        assert_all_same(rows, samples)


def test_a_row_group_holds_at_most_a_hundred_images(data, tmp_path):
    """So that a viewer that wants one image fetches little. Sets of so few images have small shards, so one is made."""
    samples = symsol_annot.load(data / "tet", "train")
    (tmp_path / "file.parquet").write_bytes(parquet.samples_to_parquet(samples, {}))
    metadata = pq.ParquetFile(tmp_path / "file.parquet").metadata
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [100, 10]


def test_the_shards_of_a_bundle_are_the_sets(bundle, data):
    for name in ("cylO", "tet", "tetX"):
        assert snapshot(bundle / "data" / name) == snapshot(data / name)
        assert verify(bundle / "data" / name) == []


def test_sha256sum_accepts_the_list_and_it_names_every_file(bundle):
    assert_whole(bundle)
    first, *lines = (bundle / "SHA256SUMS").read_text().splitlines()
    assert first == "# made by `symsol-annot publish`"
    listed = [line[66:] for line in lines]
    assert sorted([*listed, "SHA256SUMS"]) == sorted(snapshot(bundle))


def assert_whole(bundle):
    subprocess.run(["sha256sum", "-c", "--strict", "--status", "SHA256SUMS"], cwd=bundle, check=True)


def test_croissant_lists_every_shard_and_parquet_file_as_it_is(bundle):
    distribution = json.loads((bundle / "croissant.json").read_text())["distribution"]
    listed = {item["contentUrl"]: item for item in distribution if item["@type"] == "cr:FileObject"}
    files = snapshot(bundle)
    assert set(listed) == {name for name in files if name.endswith((".h5", ".parquet"))}
    for name, item in listed.items():
        assert item["sha256"] == hashlib.sha256(files[name]).hexdigest()
        assert item["contentSize"] == f"{len(files[name])} B"


def test_hugging_face_reads_the_cards_metadata_and_its_paths_name_every_parquet_file(bundle):
    import datasets
    from huggingface_hub import DatasetCard

    card = DatasetCard.load(bundle / "README.md")
    assert card.data.license == "cc-by-4.0"
    resources = Path(datasets.__file__).parent / "utils" / "resources"
    assert set(card.data.size_categories) <= set(json.loads((resources / "size_categories.json").read_text()))
    assert set(card.data.annotations_creators) <= set(
        json.loads((resources / "creators.json").read_text())["annotations"]
    )
    configs = datasets.utils.metadata.MetadataConfigs.from_dataset_card_data(card.data)
    patterns = [item["path"] for config in configs.values() for item in config["data_files"]]
    named = [path for pattern in patterns for path in bundle.glob(pattern)]
    assert sorted(named) == sorted(bundle.rglob("*.parquet"))
    assert (bundle / "dataset_card.md").read_bytes() == (bundle / "README.md").read_bytes()


def test_the_cards_figures_are_those_of_the_shards(bundle, data):
    """Counted here with h5py alone."""
    text = (bundle / "README.md").read_text()
    rows = {tuple(cells[:2]): cells for cells in table_rows(text, "marking shows")}
    contents = {tuple(cells[:2]): cells for cells in table_rows(text, "focal_px")}
    assert set(rows) == set(contents) == set(SPLITS)
    drawn = 0
    for name, split in SPLITS:
        shards = [h5py.File(path) for path in sorted((data / name).glob(f"{split}-*.h5"))]
        images = sum(len(shard["image"]) for shard in shards)
        pixels = np.concatenate([shard["marking_pixels"][:] for shard in shards])
        camera = json.loads(shards[0].attrs["camera"])
        assert contents[name, split][2] == str(images)
        assert contents[name, split][5] == f"{camera['focal_px']:.3f}"
        assert contents[name, split][6] == str(len(shards[0]["symmetry_group"]))
        if name == "tet":
            assert rows[name, split][2:] == ["", "", "12 in 110", "", ""]
            continue
        shown = pixels >= shards[0].attrs["tolerance_px"]
        assert rows[name, split][2] == f"{shown.sum()} ({100 * shown.mean():.1f}%)"
        if "symmetry_mask" not in shards[0]:
            assert rows[name, split][3:] == ["", "no symmetry sets", "", ""]
            continue
        barely = shown & (pixels < 20 * camera["width"] ** 2 / 224**2)
        sizes = np.concatenate([shard["symmetry_mask"][:].sum(axis=1) for shard in shards])
        candidates, within = (
            sum(int(s.attrs[key]) for s in shards) for key in ("candidates_drawn", "candidates_within_tolerance")
        )
        assert rows[name, split][3] == str(barely.sum())
        counts = zip(*np.unique(sizes, return_counts=True), strict=True)
        assert rows[name, split][4] == ", ".join(f"{size} in {count}" for size, count in counts)
        assert rows[name, split][5:] == [f"{candidates:,}", f"{within:,}"]
        drawn += candidates
    assert f"of {drawn:,} candidates" in text


def table_rows(text, heading):
    """The cells of the table whose head has a word."""
    table = next(block for block in text.split("\n\n") if block.startswith("|") and heading in block.splitlines()[0])
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]]


def test_the_cards_code_runs_in_the_bundle(bundle, tmp_path, monkeypatch, no_network):
    monkeypatch.chdir(bundle.parent)
    monkeypatch.setattr("datasets.config.HF_DATASETS_CACHE", tmp_path)
    by_datasets, by_symsol_annot = re.findall(
        r"```python\n(.*?)```", (bundle / "README.md").read_text(), flags=re.DOTALL
    )
    names, others = {}, {}
    exec(by_datasets, names)
    exec(by_symsol_annot, others)
    assert names["symmetry_set"].tobytes() == others["sample"].symmetry_set.tobytes()


@pytest.fixture(scope="module")
def train_alone(tmp_path_factory):
    """A folder with a set of one split, which has no symmetry sets, and its bundle."""
    folder = tmp_path_factory.mktemp("train alone")
    make_set(folder / "data", "tetX", train=20, test=0, annotate="test")
    publish(sets_in(folder / "data"), folder / "bundle", About())
    return folder


def test_the_cards_code_runs_where_there_are_no_symmetry_sets(train_alone, tmp_path, monkeypatch, no_network):
    monkeypatch.chdir(train_alone)
    monkeypatch.setattr("datasets.config.HF_DATASETS_CACHE", tmp_path)
    page = (train_alone / "bundle" / "README.md").read_text()
    by_datasets, by_symsol_annot = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names, others = {}, {}
    exec(by_datasets, names)
    exec(by_symsol_annot, others)
    assert names["rotation"].tobytes() == others["sample"].rotation.tobytes()
    assert "symmetry_set" not in by_datasets + by_symsol_annot
    assert "$" not in page


def test_the_cards_code_is_about_a_split_that_has_symmetry_sets(data, train_alone, tmp_path):
    """Of the first set that has one, and its test split rather than another."""
    shutil.copytree(train_alone / "data" / "tetX", tmp_path / "data" / "aaa")
    for name in ("tetX", "tet"):
        shutil.copytree(data / name, tmp_path / "data" / name)
    for split in ("train", "test"):
        publish(sets_in(tmp_path / "data"), tmp_path / split, About())
        name = "tet" if split == "train" else "tetX"
        assert f'load_dataset(bundle, "{name}", split="{split}")' in (tmp_path / split / "README.md").read_text()
        shutil.rmtree(tmp_path / "data" / "tet", ignore_errors=True)


def test_size_categories_are_hugging_faces():
    cases = {0: "n<1K", 999: "n<1K", 1000: "1K<n<10K", 9999: "1K<n<10K", 50_000: "10K<n<100K", 10**8: "100M<n<1B"}
    assert {images: _size_category(images) for images in cases} == cases
    assert (_size_category(10**12 - 1), _size_category(10**12)) == ("100B<n<1T", "n>1T")


def test_the_citation_has_the_softwares_references(bundle):
    ours, softwares = (yaml.safe_load((folder / "CITATION.cff").read_text()) for folder in (bundle, ROOT))
    assert ours["type"] == "dataset"
    assert ours["license"] == "CC-BY-4.0"
    assert {"cff-version", "message", "title", "authors"} <= set(ours)
    assert [reference for reference in ours["references"] if reference["type"] != "software"] == softwares["references"]
    software = next(reference for reference in ours["references"] if reference["type"] == "software")
    assert software["version"] == symsol_annot.__version__


@settings(deadline=None, max_examples=40)
@given(st.one_of(*(arrays(np.uint8, st.tuples(*[st.integers(1, 9)] * 2, *rest)) for rest in ((), (st.just(3),)))))
def test_a_png_holds_every_value(pixels):
    with Image.open(io.BytesIO(to_png(pixels))) as image:
        image.load()
        assert image.mode == ("RGB" if pixels.ndim == 3 else "L")
        assert np.array_equal(np.asarray(image), pixels)


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


def test_other_software_makes_the_mirror_again(data, tmp_path, monkeypatch):
    out = tmp_path / "bundle"
    publish(sets_in(data / "tetX"), out, About())
    before = snapshot(out)
    monkeypatch.setattr(parquet, "deflate_version", lambda: "9.9.9")
    publish(sets_in(data / "tetX"), out, About())
    made_again = {name for name, contents in snapshot(out).items() if contents != before[name]}
    assert {name for name in before if name.endswith(".parquet")} < made_again
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


def test_shards_are_links_or_copies_where_links_cannot_be(data, tmp_path, monkeypatch):
    publish(sets_in(data / "tetX"), tmp_path / "links", About())
    assert (tmp_path / "links/data/tetX/test-00000-of-00003.h5").samefile(data / "tetX/test-00000-of-00003.h5")

    def no_links(*_):
        raise OSError(errno.EXDEV, "another disk")

    monkeypatch.setattr(os, "link", no_links)
    publish(sets_in(data / "tetX"), tmp_path / "copies", About())
    assert not (tmp_path / "copies/data/tetX/test-00000-of-00003.h5").samefile(data / "tetX/test-00000-of-00003.h5")
    assert snapshot(tmp_path / "copies") == snapshot(tmp_path / "links")


def assert_refused(folder, out, error, *words):
    """Refused with these words, and whatever is in the output folder stays as it is."""
    before = snapshot(out)
    with pytest.raises(error) as caught:
        publish(sets_in(folder), out, About())
    assert all(word in str(caught.value) for word in words), caught.value
    assert snapshot(out) == before


def test_a_damaged_shard_is_named_and_nothing_is_published(tetX_set, tmp_path):
    for shard in ("test-00001-of-00003.h5", "test-00002-of-00003.h5"):
        damaged = bytearray((tetX_set / shard).read_bytes())
        damaged[len(damaged) // 2] ^= 1
        (tetX_set / shard).write_bytes(damaged)
    assert_refused(
        tetX_set, tmp_path / "out", DataError, "test-00001-of-00003.h5", "test-00002-of-00003.h5", "--repair"
    )
    assert not (tmp_path / "out").exists()


def test_an_unfinished_set_is_refused(tetX_set, tmp_path):
    manifest = read_manifest(tetX_set)
    unfinished = replace(manifest.shards[-1], bytes=None, sha256=None, content_sha256=None)
    write_manifest(tetX_set, manifest.with_finished(unfinished))
    assert_refused(tetX_set, tmp_path / "out", DataError, "is not finished: 1 shards are missing")


def test_a_folder_without_sets_or_with_a_name_that_hosts_do_not_take_is_refused(tetX_set, tmp_path):
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", tmp_path / "out", DataError, "holds no manifest.json")
    assert_refused(tmp_path / "nowhere", tmp_path / "out", DataError, "holds no manifest.json")
    assert_refused(tetX_set.rename(tmp_path / "my set"), tmp_path / "out", DataError, "'my set'", "rename it")
    reserved = (tmp_path / "my set").rename(tmp_path / "symmetry_groups")
    assert_refused(reserved, tmp_path / "out", DataError, "'symmetry_groups'", "rename")


def test_an_imported_set_is_refused(tetX_set, tmp_path):
    manifest = read_manifest(tetX_set)
    source = Source("symsol.zip", "0" * 64, "unknown", transposed=False, rotations_listed=12, duplicates_removed=0)
    width, height = manifest.settings.image_size
    settings = ImportedSettings(object="tetX", annotate="test", width=width, height=height, source=source)
    write_manifest(tetX_set, replace(manifest, settings=settings))
    assert_refused(tetX_set, tmp_path / "out", DataError, "imported", "licence")


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


def test_a_shard_that_changes_meanwhile_is_not_published(tetX_set, tmp_path):
    shards, calls = sorted(tetX_set.glob("test-*.h5")), []

    def change_after_verifying():
        calls.append(1)
        if len(calls) == 4:  # all are verified
            shards[0].write_bytes(shards[1].read_bytes())

    with pytest.raises(DataError, match=r"changed while it was published|no shard of this set"):
        publish(sets_in(tetX_set), tmp_path / "out", About(), change_after_verifying)
    assert not (tmp_path / "out" / "data" / "tetX" / shards[0].name).exists()


@pytest.mark.parametrize(
    "wrong",
    [
        {"title": ""},
        {"title": "two\nlines"},
        {"authors": ()},
        {"version": "1"},
        {"date": "31.1.2026"},
        {"url": "ftp://x"},
    ],
)
def test_what_hosts_refuse_is_refused(wrong):
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        About(**wrong)


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_the_publishing_page_runs_word_for_word(data, tmp_path, monkeypatch, no_network):
    """All but installing and uploading."""
    page = (ROOT / "docs" / "publishing.md").read_text()
    (tmp_path / "data").symlink_to(data)
    _, publishing, checking = re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL)[0].strip().splitlines()
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    done = run("sh", "-c", f"{publishing} && {checking}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "cylO, tet, tetX: 12 shards, 159 images" in done.stdout
    assert 'pretty_name: "Symmetric objects"' in (tmp_path / "bundle" / "README.md").read_text()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("datasets.config.HF_DATASETS_CACHE", tmp_path / "cache")
    by_datasets, by_croissant = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names, others = {}, {}
    exec(by_datasets, names)
    exec(by_croissant, others)
    test = symsol_annot.load("data/cylO")
    assert names["symmetry_set"].tobytes() == test[0].symmetry_set.tobytes()
    assert np.array_equal(others["record"]["cylO_test/rotation"], test[-1].rotation)


def test_bad_input_to_the_command_is_one_message(tmp_path):
    refused = run(*COMMAND, tmp_path / "nowhere", "--out", tmp_path / "out")
    assert refused.returncode == 1
    assert refused.stderr.startswith("Error: nothing was published:")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--title", ""),
        ("--title", "A {b"),
        ("--title", "}A{"),
        ("--title", b"A \xff"),
        ("--author", ""),
        ("--author", "B} C"),
        ("--version", ""),
        ("--version", "\u0661.0.0"),
        ("--date", ""),
        ("--date", "\u0662\u0660\u0662\u0666-01-31"),
        ("--url", ""),
        ("--url", "https://"),
        ("--url", b"https://x/\xff"),
        ("--url", "https://x/}{"),
        ("--url", "https://x/\\"),
        ("--url", "https://x/y z"),
        ("--url", "https://x/\u00e4"),
    ],
)
def test_the_command_refuses_what_hosts_and_bibtex_refuse(data, tmp_path, option, value):
    words = [*COMMAND, data / "tetX", "--out", tmp_path / "out", option, value]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(rf"Error: .*{option[2:]}.*: expected .*, found .*\n", done.stderr)
    assert not (tmp_path / "out").exists()


def test_the_command_takes_what_they_take(data, tmp_path):
    url = "https://example.org/~a/b?c=1&d=%7B#e_[1];f|g"
    given = ("--title", "{SO}(3), {{b}}", "--author", "Ä. {P}", "--author", "B", "--version", "10.0.1", "--url", url)
    done = run(*COMMAND, data / "tetX", "--out", tmp_path / "out", *given)
    assert done.returncode == 0, done.stderr
    entry = re.search(r"```bibtex\n(.*?)```", (tmp_path / "out" / "README.md").read_text(), flags=re.DOTALL)[1]
    for line in (
        "title = {{{SO}(3), {{b}}}},",
        "author = {{Ä. {P}} and {B}},",
        "version = {10.0.1},",
        f"url = {{{url}}},",
    ):
        assert f"  {line}\n" in entry
    assert yaml.safe_load((tmp_path / "out" / "CITATION.cff").read_text())["url"] == url


def test_without_pyarrow_the_command_says_what_to_install(data, tmp_path):
    blocked = "import sys; sys.modules['pyarrow'] = None; from symsol_annot_cli.main import main; main()"
    done = run(sys.executable, "-c", blocked, "publish", data / "tetX", "--out", tmp_path / "out")
    assert done.returncode == 1
    message = "publishing needs pyarrow, which is not installed: `pip install 'symsol-annot[publish]'`"
    assert done.stderr == f"Error: {message}\n"


@pytest.mark.parametrize("split", ["test", "train"])
def test_the_examples_see_the_same_in_a_bundle_and_in_a_shard(bundle, data, tmp_path, split):
    """examples/datasets_example.py reads the Parquet mirror, examples/plain_h5py.py the shards."""
    environment = {**os.environ, "HF_DATASETS_CACHE": str(tmp_path)}
    by_datasets = run(sys.executable, ROOT / "examples" / "datasets_example.py", bundle, "tetX", split, env=environment)
    assert by_datasets.returncode == 0, by_datasets.stderr
    by_h5py = []
    for shard in sorted((data / "tetX").glob(f"{split}-*.h5")):
        done = run(sys.executable, ROOT / "examples" / "plain_h5py.py", shard)
        assert done.returncode == 0, done.stderr
        by_h5py += [line.partition(": ")[2] for line in done.stdout.splitlines()[1:]]
    lines = [line.partition(": ")[2] for line in by_datasets.stdout.splitlines()]
    expected = [
        f"mean {sample.image.mean():.3f}, marking {'shown' if sample.marking_visible else 'not shown'}, "
        + (f"{len(sample.symmetry_set)} rotations" if split == "test" else "no symmetry set")
        for sample in symsol_annot.load(data / "tetX", split)
    ]
    assert lines == by_h5py == expected
