"""What a shard says of itself."""

import json

import h5py
import numpy as np
from made_shards import HEADER, HEIGHT, NOTES, WIDTH, build, header

from symsol_annot.sets.shard.reader import open_shard


def test_attributes_say_everything_needed_to_make_the_shard_again(shard):
    with h5py.File(shard) as file:
        found = {name: file.attrs[name] for name in file.attrs}
    for name in ("camera", "render", "versions"):
        found[name] = json.loads(found[name])
    assert found == {
        "format": "symsol-annot shard",
        "format_version": 1,
        "object": "mug",
        "object_sha256": "ab" * 32,
        "split": "test",
        "first_index": 32,
        "seed": 7,
        "camera": {"distance": 4.0, "focal_px": 27.9, "width": WIDTH, "height": HEIGHT},
        "render": {
            "engine": "cycles",
            "samples_per_axis": 2,
            "body_colour": [0.72, 0.80, 0.94],
            "marking_colour": [0.95, 0.16, 0.04],
            "background_colour": [1.0, 1.0, 1.0],
            "ambient": 0.5,
            "diffuse": 0.96,
        },
        "engine": "cycles",
        "tolerance_px": 0.25,
        "versions": HEADER.versions,
        **NOTES,
    }


def test_tolerance_of_an_object_without_marking_is_nan(tmp_path):
    path = tmp_path / "plain.h5"
    path.write_bytes(build(header(tolerance_px=None)).data)
    with open_shard(path) as shard:
        assert np.isnan(shard.attributes["tolerance_px"])
