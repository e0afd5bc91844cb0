"""The card of a bundle: hosts read its metadata, and its code runs."""

import json
import re
import shutil
from pathlib import Path

import pytest
from made_sets import make_set

from symsol_annot.publish.about import About
from symsol_annot.publish.card import _size_category
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in


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
