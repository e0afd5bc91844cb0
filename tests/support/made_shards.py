"""Shards of arbitrary contents: how they are made, read whole, and refused."""

from dataclasses import replace

import numpy as np
import pytest

from symsol_annot.errors import DataError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.shard.header import ShardHeader
from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.shard.writer import ImageRecord, ShardWriter
from symsol_annot.sets.stated.settings import RenderedSettings

PICTURES = ("image", "segmentation", "depth")  # a row per chunk
COUNT, HEIGHT, WIDTH = 5, 12, 16  # not square, so that height and width cannot be swapped
GROUP = np.array([[[c, -s, 0], [s, c, 0], [0, 0, 1]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))], dtype=float)
SETTINGS = RenderedSettings(
    object="mug",
    object_sha256="ab" * 32,
    seed=7,
    camera=Camera(4.0, 27.9, WIDTH, HEIGHT),
    render=RenderSettings("cycles", ambient=0.5),
    tolerance_px=0.25,
    annotate="all",
)
HEADER = ShardHeader(SETTINGS, "test", 32, versions={"renderer": "none", "hdf5": "0"})


def header(**changes):
    """The header of a shard whose set has other settings."""
    return replace(HEADER, settings=replace(SETTINGS, **changes))


DEEP = header(render=RenderSettings("opengl", ambient=0.5, depth=True))
NOTES = {"candidates_drawn": 11, "candidates_within_tolerance": 2}
LAYOUT = {  # in the order of the digest of the contents; the group comes last
    "image": ("|u1", (COUNT, HEIGHT, WIDTH, 3)),
    "segmentation": ("|u1", (COUNT, HEIGHT, WIDTH)),
    "depth": ("<f4", (COUNT, HEIGHT, WIDTH)),
    "rotation": ("<f8", (COUNT, 3, 3)),
    "marking_pixels": ("<f4", (COUNT,)),
    "part_pixels": ("<f4", (COUNT, 2)),
    "symmetry_mask": ("|b1", (COUNT, len(GROUP))),
}


def records(annotated=True, depth=False, order=4):
    """Arbitrary contents: a shard stores what it is given."""
    rng = np.random.default_rng(0)
    return [
        ImageRecord(
            view=View(
                rng.integers(256, size=(HEIGHT, WIDTH, 3), dtype=np.uint8),
                rng.integers(3, size=(HEIGHT, WIDTH), dtype=np.uint8),
                np.array([4.0, 0.25]),
                rng.random((HEIGHT, WIDTH), dtype=np.float32) if depth else None,
            ),
            R_m2c=rng.standard_normal((3, 3)),
            coset_px=float(np.float32(rng.random())),
            symmetry_mask=rng.random(order) < 0.5 if annotated else None,
        )
        for _ in range(COUNT)
    ]


def build(header=DEEP, annotated=True, before_image=lambda: None, group=GROUP):
    writer = ShardWriter(header, COUNT, group, annotated=annotated)
    try:
        for record in records(annotated, header.settings.has_depth, len(group)):
            before_image()
            writer.add(record)
        return writer.finish(NOTES)
    finally:
        writer.close()


def refusal(path):
    """Open a shard that must be refused, and return why."""
    with pytest.raises(DataError) as refused, open_shard(path):
        pass
    assert str(path) in str(refused.value)
    return str(refused.value)


def read_all(path):
    """Open a shard with all there can be in one and read every value of it: name to array."""
    with open_shard(path) as shard:
        whole = {name: shard.read(name) for name in shard.arrays}
        for name in PICTURES:
            np.testing.assert_array_equal(np.stack(list(shard.rows(name))), whole[name])
        return {**whole, "symmetry_group": shard.labels().symmetry_group}
