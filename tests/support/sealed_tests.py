"""Sealed tests made with the numpy renderer, and methods that predict them without looking at a pixel."""

import json
import re
import string
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from made_sets import make_plan, threads
from numpy_renderer import NumpyRenderer

from symsol_annot.generation.maker import software_of
from symsol_annot.sealing import making
from symsol_annot.sets.plan import label_rotation

NAME, IMAGES, SIZE = "tetX", 24, 24
SEED = 0x0123456789ABCDEF0123456789ABCDEF  # in tests that compare bytes


def plan_to_seal(images=IMAGES):
    return make_plan(NAME, test=images, size=SIZE)


def renderer(on_frame=lambda: None):
    return NumpyRenderer(NAME, SIZE, on_frame)


def software(_plan=None):
    return software_of(renderer())


def workers(on_frame=lambda: None):
    return threads(partial(renderer, on_frame))


def sealed_test(folder, images=IMAGES):
    """Make a sealed test, its images too; the folder is returned."""
    making.seal(plan_to_seal(images), software(), folder)
    making.render(folder, workers(), software)
    return folder


def everything_in(folder):
    """All files below a folder: name to bytes."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*.*"))}


def metadata_of(folder):
    """All that a set's files say but for pixels: names, sizes, texts, attributes and what HDF5 tells of its chunks."""
    said = []
    for path in sorted(folder.iterdir()):
        said += [path.name, str(path.stat().st_size)]
        if path.suffix == ".json":
            said.append(path.read_text())
            continue
        with h5py.File(path) as file:
            said += [f"{name} {value}" for name, value in file.attrs.items() if np.ndim(value) == 0]
            for name, dataset in file.items():
                chunks = [dataset.id.get_chunk_info(i) for i in range(dataset.id.get_num_chunks())]
                said += [name, *(f"{chunk.byte_offset} {chunk.size}" for chunk in chunks)]
    return "\n".join(said)


def seeds_in(text):
    """Every number that a text may mean as a seed: its numerals, and its hexadecimal words, whole or in halves."""
    words = set(re.findall(r"[0-9a-f]+", text))
    decimal = {int(word) for word in words if word.isdecimal()}
    parts = {part for word in words for part in (word, word[:16], word[:32], word[-32:], word[-16:])}
    return decimal | {int(part, 16) for part in parts if part and set(part) <= set(string.hexdigits)}


def found_by_metadata(folder, R_of_first, split="test"):
    """The seed among a set's metadata that gives its first image such a rotation (3, 3); None where there is none.

    It is told the first image's rotation, which makes it stronger than any who has to guess that from the picture.
    """
    for seed in sorted(seeds_in(metadata_of(folder))):
        if np.allclose(label_rotation(seed, NAME, split, 0), R_of_first):
            return seed
    return None


def manifest_of(folder):
    return json.loads(Path(folder, "manifest.json").read_text())
