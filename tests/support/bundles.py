"""What a bundle is compared with: the sets that are in it, its bytes, and what refuses it."""

import io
import json
import subprocess
import tarfile
from itertools import groupby

import numpy as np
import pytest
from PIL import Image

from symsol_annot.publish.about import About
from symsol_annot.publish.publication import publish
from symsol_annot.publish.sets import sets_in

SPLITS = [("cylO", "test"), ("tet", "train"), ("tetX", "train"), ("tetX", "test")]  # tetX's train has no sets


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
    assert np.array_equal(np.float32(row["part_pixels"]), sample.part_pixels)


def assert_all_same(rows, samples):
    assert len(rows) == len(samples)
    for row, sample in zip(rows, samples, strict=True):
        assert_same(row, sample)


def records_in_tar(path):
    """The files of each image by their endings, as WebDataset groups them: by the name up to the first dot."""
    with tarfile.open(path) as archive:
        files = [(member.name.partition("."), archive.extractfile(member).read()) for member in archive]
    for _, group in groupby(files, key=lambda file: file[0][0]):
        yield {ending: data for (_, _, ending), data in group}


def row_of_record(record, group):
    """A record of a WebDataset, its files decoded, as a row of any mirror; `group` is the set's symmetry group."""
    symmetries = record["json"]["symmetries"]
    mask = None if symmetries is None else np.isin(np.arange(len(group)), symmetries)
    return {
        **record["json"],
        "image": record["png"],
        "segmentation": record["segmentation.png"],
        "symmetry_mask": mask,
    }


def assert_all_in_tar_files(folder, split, samples):
    """The tar files of a WebDataset hold these samples, to the bit, and nothing else."""
    records = [record for path in sorted(folder.glob(f"{split}-*.tar")) for record in records_in_tar(path)]
    assert len(records) == len(samples)
    group = np.load(folder / "symmetry_group.npy")
    for sample, record in zip(samples, records, strict=True):
        assert set(record) == {"png", "segmentation.png", "json"}
        pictures = {name: Image.open(io.BytesIO(record[name])) for name in ("png", "segmentation.png")}
        labels = json.loads(record["json"])
        assert_same(row_of_record({**pictures, "json": labels}, group), sample)
        if sample.is_annotated:
            members = np.array(labels["rotation"]) @ group[labels["symmetries"]]
            assert np.array_equal(members, sample.symmetry_set.members)


def assert_whole(bundle):
    subprocess.run(["sha256sum", "-c", "--strict", "--status", "SHA256SUMS"], cwd=bundle, check=True)


def assert_refused(folder, out, error, *words):
    """Refused with these words, and whatever is in the output folder stays as it is."""
    before = snapshot(out)
    with pytest.raises(error) as caught:
        publish(sets_in(folder), out, About())
    assert all(word in str(caught.value) for word in words), caught.value
    assert snapshot(out) == before
