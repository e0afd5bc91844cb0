"""The page on publishing and the examples of reading what is published run as they stand."""

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_sets import run
from bundles import snapshot

import symsol_annot

ROOT = Path(__file__).parents[2]


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_the_publishing_page_runs_word_for_word(data, tmp_path, monkeypatch, no_network):
    """All but installing and uploading."""
    page = (ROOT / "docs" / "publishing.md").read_text()
    (tmp_path / "data").symlink_to(data)
    first, fetching = re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL)
    _, publishing, checking = first.strip().splitlines()
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    done = run("sh", "-c", f"{publishing} --webdataset && {checking} && {fetching}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "cylO, tet, tetX: 12 shards, 159 images" in done.stdout
    assert snapshot(tmp_path / "elsewhere" / "cylO") == snapshot(data / "cylO")
    assert 'pretty_name: "Symmetric objects"' in (tmp_path / "bundle" / "README.md").read_text()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("datasets.config.HF_DATASETS_CACHE", tmp_path / "cache")
    by_datasets, by_tar_files, by_croissant = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    names, packed, others = {}, {}, {}
    exec(by_datasets, names)
    exec(by_tar_files, packed)
    exec(by_croissant, others)
    test = symsol_annot.load("data/cylO")
    assert names["symmetry_set"].tobytes() == test[0].symmetry_set.tobytes()
    assert [row["json"]["rotation"] for row in packed["rows"]] == [sample.rotation.tolist() for sample in test]
    assert np.array_equal(others["record"]["cylO_test/rotation"], test[-1].rotation)


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
        f"mean {sample.image.mean():.3f}, "
        f"{sample.part_pixels[0]:g} px of body, {sample.part_pixels[1]:g} px of marking, "
        f"marking {'shown' if sample.marking_visible else 'not shown'}, "
        + (f"{len(sample.symmetry_set)} rotations" if split == "test" else "no symmetry set")
        for sample in symsol_annot.load(data / "tetX", split)
    ]
    assert lines == by_h5py == expected
