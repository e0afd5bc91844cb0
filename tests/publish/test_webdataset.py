"""The WebDataset mirror, read with tarfile, json, numpy and Pillow, has every sample of the set."""

import numpy as np
import pytest
from bundles import assert_all_in_tar_files, assert_all_same, assert_whole, row_of_record
from click.testing import CliRunner
from symsol_annot_cli.publish import publish as publish_command

import symsol_annot


@pytest.fixture(scope="module")
def mirror(data, tmp_path_factory):
    out = tmp_path_factory.mktemp("webdataset") / "bundle"
    for _ in range(2):  # the second time it is all there
        done = CliRunner().invoke(publish_command, [str(data / "tetX"), "--out", str(out), "--webdataset"])
        assert done.exit_code == 0, done.output
    assert_whole(out)
    return out / "webdataset" / "tetX"


@pytest.mark.parametrize("split", ["train", "test"])
def test_every_sample_is_in_the_tar_files_to_the_bit(mirror, data, split):
    assert_all_in_tar_files(mirror, split, symsol_annot.load(data / "tetX", split))


def test_datasets_reads_every_sample_of_the_tar_files_offline(mirror, data, tmp_path, no_network):
    import datasets

    files = str(mirror / "test-*.tar")
    rows = datasets.load_dataset("webdataset", data_files=files, split="train", cache_dir=str(tmp_path))
    group = np.load(mirror / "symmetry_group.npy")
    assert_all_same([row_of_record(row, group) for row in rows], symsol_annot.load(data / "tetX", "test"))
