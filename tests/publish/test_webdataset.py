"""The WebDataset mirror, read with tarfile, json, numpy and Pillow, has every sample of the set."""

import io
import json
import tarfile
from itertools import groupby

import numpy as np
import pytest
from bundles import assert_whole
from click.testing import CliRunner
from PIL import Image
from symsol_annot_cli.publish import publish as publish_command

import symsol_annot


def records_in(path):
    """The files of each image by their endings, as WebDataset groups them: by the name up to the first dot."""
    with tarfile.open(path) as archive:
        files = [(member.name.partition("."), archive.extractfile(member).read()) for member in archive]
    for _, group in groupby(files, key=lambda file: file[0][0]):
        yield {ending: data for (_, _, ending), data in group}


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
    samples = symsol_annot.load(data / "tetX", split)
    records = [record for path in sorted(mirror.glob(f"{split}-*.tar")) for record in records_in(path)]
    assert len(records) == len(samples)
    group = np.load(mirror / "symmetry_group.npy")
    for sample, record in zip(samples, records, strict=True):
        assert set(record) == {"png", "segmentation.png", "json"}
        assert np.array_equal(np.array(Image.open(io.BytesIO(record["png"]))), sample.image)
        assert np.array_equal(np.array(Image.open(io.BytesIO(record["segmentation.png"]))), sample.segmentation)
        labels = json.loads(record["json"])
        rotation = np.array(labels["rotation"])
        assert rotation.tobytes() == sample.rotation.tobytes()
        assert (labels["index"], labels["marking_visible"]) == (sample.index, sample.marking_visible)
        assert labels["marking_pixels"] == sample.marking_pixels
        if sample.is_annotated:
            assert np.array_equal(rotation @ group[labels["symmetries"]], sample.symmetry_set.members)
        else:
            assert labels["symmetries"] is None
