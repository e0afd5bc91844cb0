"""The sets that are attacked: with and without a marking or depth, rendered and imported, of each format version.

Those of the newest are made once with the ray caster; of version 1, which nothing writes any more, some are kept.
"""

import shutil
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

from attack.signing import read_document

LABELS = ("rotation", "symmetry_mask", "marking_pixels", "part_pixels")
_VERSION_1 = Path(__file__).parents[2] / "tests" / "data" / "format_1"


class Original(NamedTuple):
    """A whole set.

    Attributes:
        folder: of its files.
        name: the object's.
        split: which has sets, or whose images are read.
        columns: data set to the rows of that split, as h5py reads them.
        group: (G, 3, 3).
        has_marking: whether its object has one that is told of.
        is_annotated: whether the split has symmetry sets.
    """

    folder: Path
    name: str
    split: str
    columns: dict
    group: np.ndarray
    has_marking: bool
    is_annotated: bool

    @property
    def shards(self):
        """The files of the split, in order."""
        return sorted(self.folder.glob(f"{self.split}-*.h5"))


def make_sets(folder):
    """Make the sets; needs what lies beside the package's own tests."""
    import symsol_source
    from bench_sets import small_set
    from made_sets import make_set

    from symsol_annot.symsol.importing import import_symsol

    make_set(folder / "rendered", "tetX", train=6, test=20, size=16)
    make_set(folder / "rendered", "tet", test=6, size=16)
    small_set(folder / "rendered", "cylO", images=6)
    make_set(folder / "deep", "tetX", test=6, size=16, depth=True)
    for kept in _VERSION_1.glob("*/*"):
        shutil.copytree(kept, folder / f"{kept.parent.name} of version 1" / kept.name)
    files, _ = symsol_source.content(("tet", "cyl", "tetX"), counts={"train": 2, "test": 4})
    list(import_symsol(symsol_source.write_zip(folder / "symsol.zip", files), folder / "imported", ()))


def read_originals(folder):
    """Return all sets that `make_sets` made."""
    return [_original(path.parent) for path in sorted(folder.glob("*/*/manifest.json"))]


def put_set(original, folder):
    """Copy a set's files; return the new set's folder."""
    to = folder / original.name
    to.mkdir(parents=True)
    for path in original.folder.iterdir():
        if path.is_file():
            shutil.copyfile(path, to / path.name)
    return to


def _original(folder):
    document, split = read_document(folder), "test"
    columns, group = {}, None
    for path in sorted(folder.glob(f"{split}-*.h5")):
        with h5py.File(path, "r") as file:
            group = file["symmetry_group"][...] if "symmetry_group" in file else file.attrs["symmetry_group"]
            for name in file:
                if name != "symmetry_group":
                    columns.setdefault(name, []).append(file[name][...])
    assert group is not None, f"{folder} has no shard of the {split} split"
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Original(
        folder,
        folder.name,
        split,
        joined,
        group,
        has_marking=document["tolerance_px"] is not None,
        is_annotated="symmetry_mask" in joined,
    )
