"""What a shard says of itself."""

import hashlib
import json
from dataclasses import replace

import h5py
import numpy as np
from made_shards import DEEP, GROUP, HEIGHT, NOTES, WIDTH, header, records

from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.shard.writer import ShardWriter


def test_attributes_say_everything_needed_to_make_the_shard_again(shard):
    with h5py.File(shard) as file:
        found = {name: file.attrs[name] for name in file.attrs}
    np.testing.assert_array_equal(found.pop("symmetry_group"), GROUP)
    assert found.pop("symmetry_group_sha256") == hashlib.sha256(GROUP).hexdigest()
    for name in ("camera", "render", "versions", "parts"):
        found[name] = json.loads(found[name])
    assert found == {
        "format": "symsol-annot shard",
        "format_version": 2,
        "object": "mug",
        "object_sha256": "ab" * 32,
        "split": "test",
        "first_index": 32,
        "seed": 7,
        "camera": {"distance": 4.0, "focal_px": 27.9, "width": WIDTH, "height": HEIGHT},
        "render": {
            "engine": "opengl",
            "samples_per_axis": 2,
            "body_colour": [0.72, 0.80, 0.94],
            "marking_colour": [0.95, 0.16, 0.04],
            "background_colour": [1.0, 1.0, 1.0],
            "ambient": 0.5,
            "diffuse": 0.96,
            "depth": True,
        },
        "engine": "opengl",
        "tolerance_px": 0.25,
        "parts": ["body", "marking"],
        "versions": DEEP.versions,
        **NOTES,
    }


def test_tolerance_of_an_object_without_marking_is_nan(tmp_path):
    path = tmp_path / "plain.h5"
    with ShardWriter(header(tolerance_px=None), 1, GROUP, annotated=True) as writer:
        record = records()[0]
        writer.add(replace(record, view=replace(record.view, part_pixels=np.ones(1))))
        path.write_bytes(writer.finish(NOTES).data)
    with open_shard(path) as shard:
        assert np.isnan(shard.attributes["tolerance_px"])
