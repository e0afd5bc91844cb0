"""Sets in words: what a sample shows of itself in a session, and why a split has no symmetry sets."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume


class _Sample(Protocol):
    """What is said of a sample."""

    @property
    def index(self) -> int: ...
    @property
    def image(self) -> npt.NDArray[np.uint8]: ...
    @property
    def segmentation(self) -> npt.NDArray[np.uint8] | None: ...
    @property
    def depth(self) -> npt.NDArray[np.float32] | None: ...
    @property
    def marking_visible(self) -> bool | None: ...
    @property
    def symmetry_mask(self) -> npt.NDArray[np.bool_] | None: ...
    @property
    def volume(self) -> Volume | None: ...


def sample_in_words(sample: _Sample) -> str:
    """Return a line on a sample: its index, its size, what it holds, how large its symmetry set is."""
    height, width = sample.image.shape[:2]
    mask = sample.symmetry_mask
    maps = [name for name in ("segmentation", "depth") if getattr(sample, name) is not None]
    shown = {True: ["marking visible"], False: ["marking not visible"], None: []}[sample.marking_visible]
    size = "no symmetry set" if mask is None else f"symmetry set of {np.count_nonzero(mask)} of {len(mask)} candidates"
    if sample.volume is not None:
        size = f"symmetry set of {sample.volume.measure:.1%} of all rotations"
    return f"<Sample {sample.index}: {', '.join([f'{width}x{height} image', *maps, *shown, size])}>"


def without_sets(*, is_imported: bool, is_sealed: bool) -> str:
    """Say why a split has no symmetry sets."""
    if is_sealed:
        return "is sealed: its labels are with whoever has its secret (docs/sealed.md)"
    if is_imported:
        return "was imported from a source that gives no symmetry sets for it: none are known"
    return "was rendered without symmetry sets; `symsol-annot render --annotate all` gives every split its sets"
