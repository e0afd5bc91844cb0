"""What a predictions file holds, checked before anything in it is read: names, types, shapes, sizes, filters."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.advice.mends import mend_of_name, mend_of_shape
from symsol_annot.bench.predictions.contents import Contents
from symsol_annot.bench.predictions.faults import FaultLog
from symsol_annot.bench.predictions.format import (
    FILTERS,
    IMAGE_INDEX,
    INTEGERS,
    MAX_CHUNK_BYTES,
    PREDICTIONS_FORMAT,
    PREDICTIONS_FORMAT_VERSION,
    THE_FILE,
    is_level,
    version_fault,
)
from symsol_annot.bench.predictions.queries import group_sha256
from symsol_annot.bench.predictions.truth import Subject
from symsol_annot.errors import PredictionsError
from symsol_annot.rotations.grid import grid_sha256
from symsol_annot.system.sandbox.hdf5_process import DatasetFacts

_MAX_EXPANSION = 1100  # gzip's is 1032; what is larger was never written
_FREE_BYTES = 2**26  # of such a data set
_SHOWN_CHARACTERS = 100
_WORDS = {str: "a string", int: "a whole number", float: "a number"}
_ADVICE = {
    "group_sha256": "; the queries were asked in the order of another group: `symsol-annot queries` writes this one",
    "grid_sha256": "; the grid is another one, or in another order: `symsol-annot queries` writes this one",
    "object": "; --data names a set of another object",
}


def shown(value: Any) -> str:
    """Return a file's value for a message: in quotes, with control characters escaped, and short."""
    return repr(value) if len(repr(value)) <= _SHOWN_CHARACTERS else f"{repr(value)[:_SHOWN_CHARACTERS]}..."


class Structure:
    """A file's attributes and data sets, held against the format and the split. Faults go to the log.

    Attributes:
        file: the predictions file.
        about: the split that it is about.
        faults: where faults go.
        image_index: (N,) which image each row is about; None where that is broken.
    """

    def __init__(self, file: Contents, about: Subject, faults: FaultLog, track_of_dataset: Mapping[str, str]) -> None:
        """Check what the file's data sets are, and read its image index.

        Args:
            file: the predictions file.
            about: the split that it is about.
            faults: where faults go.
            track_of_dataset: name of a data set of the format to the name of its track.
        """
        self.file, self.about, self.faults = file, about, faults
        self._track_of_dataset = track_of_dataset
        self._file_bytes = file.size_bytes
        self._facts = {name: facts for name, facts in file.datasets.items() if self._is_readable(name, facts)}
        self.image_index = self._read_image_index()

    @property
    def rows(self) -> int | str:
        """N, or the letter where the images are not known."""
        return "N" if self.image_index is None else len(self.image_index)

    def has(self, name: str) -> bool:
        """Tell whether there is anything of this name, readable or not."""
        return name in self.file.datasets

    def facts(self, name: str) -> DatasetFacts:
        """Return what a data set is that was found to be readable."""
        return self._facts[name]

    def read_integers(self, name: str) -> npt.NDArray[np.int64] | None:
        """Return a whole data set; None where it cannot be read, which is a fault."""
        try:
            return self.file.read(name, 0, self._facts[name].shape[0]).astype(np.int64)
        except PredictionsError as error:
            for fault in error.faults:
                self.faults.add(THE_FILE, fault)
            return None

    def read_reals(self, name: str, start: int, stop: int) -> npt.NDArray[np.float64]:
        """Return rows of a data set as f8, whatever is in them."""
        with np.errstate(invalid="ignore"):  # a signalling NaN
            return self.file.read(name, start, stop).astype(np.float64)

    def has_attributes(self, expected: dict[str, type], track: str) -> bool:
        """Check that attributes are there, of their types, and say what the split does."""
        found, right, before = self.file.attributes, self._right_attributes(), len(self.faults)
        for name, kind in expected.items():
            value, odd = found.get(name), self.file.odd_attributes.get(name)
            if odd or value is None:
                reason = f"is not {_WORDS[kind]} but {odd}" if odd else f"is missing; it is {_WORDS[kind]}"
                self.faults.add(track, f"attribute {name!r} {reason}{self._line(name, right)}")
            elif not isinstance(value, int | float if kind is float else kind):
                self.faults.add(track, f"attribute {name!r}: expected {_WORDS[kind]}, found {shown(value)}")
            elif fault := self._fault_of_value(name, value, right):
                self.faults.add(track, fault)
        return len(self.faults) == before

    def _fault_of_value(self, name: str, value: Any, right: dict[str, Any]) -> str:
        """Say why an attribute's value is not the one that it should be, as far as that is known; "" where it is."""
        if name == "format_version":
            return version_fault(value, right[name])
        if name not in right or value == right[name]:
            return ""
        advice = self._advice_on_fingerprint(value) if name == "fingerprint" else _ADVICE.get(name, "")
        return f"attribute {name!r}: expected {right[name]!r}, found {shown(value)}{advice}"

    def _advice_on_fingerprint(self, found: str) -> str:
        """Say what a wrong fingerprint is of, and what to do."""
        about = self.about
        line = f"f.attrs['fingerprint'] = symsol_annot.load({about.folder!r}, {about.split!r}).fingerprint"
        if found in about.other_fingerprints:
            return f"; that is {about.other_fingerprints[found]}, where the {about.split} split's belongs: {line}"
        return (
            "; the file is about another data set, or another version of it: --data names the set that it is about, or "
            f"predict the images of this one, whose fingerprint `symsol-annot info {about.folder}` prints"
        )

    def _line(self, name: str, right: dict[str, Any]) -> str:
        """Return the line that writes an attribute; "" where its value is the method's own."""
        return f": f.attrs[{name!r}] = {right[name]!r}" if name in right else ""

    def is_shaped(self, name: str, types: tuple[str, ...], shape: tuple[int | str, ...]) -> bool:
        """Check a data set's type and shape, in which a letter stands for any size."""
        facts = self._facts.get(name)
        if facts is None:
            if not self.has(name):
                line = (
                    f"; f[{name!r}] = range({len(self.about)}) where rows are in order" if name == IMAGE_INDEX else ""
                )
                self.faults.add(self._track_of(name), f"data set {name!r} is missing{line}")
            return False
        fits = len(facts.shape) == len(shape) and all(
            isinstance(want, str) or have == want for have, want in zip(facts.shape, shape, strict=True)
        )
        if facts.dtype in types and fits:
            return self._is_contained(name, facts)
        wanted = f"{' or '.join(t[1:] for t in types)} of shape ({', '.join(map(str, shape))})"
        found = f"{facts.dtype[1:]} of shape {facts.shape}"
        mend = mend_of_shape(name, facts.shape, facts.dtype, len(self.about))
        self.faults.add(self._track_of(name), f"{name!r}: expected {wanted}, found {found}{mend and f'; {mend}'}")
        return False

    def _is_contained(self, name: str, facts: DatasetFacts) -> bool:
        """Check that a data set's bytes can have come from the file, so that work is bounded by the file's size."""
        size = math.prod(facts.shape) * np.dtype(facts.dtype).itemsize
        if size <= _FREE_BYTES + _MAX_EXPANSION * self._file_bytes:
            return True
        found = f"of shape {facts.shape} holds {size / 2**30:.3g} GiB, but the file is one of {self._file_bytes} bytes"
        self.faults.add(self._track_of(name), f"{name!r} {found}: most of it was never written")
        return False

    def _track_of(self, dataset: str) -> str:
        """Return the track that a data set belongs to, or "the file"."""
        return self._track_of_dataset.get(dataset, THE_FILE)

    def _right_attributes(self) -> dict[str, Any]:
        about, level = self.about, self.file.attributes.get("grid_level")
        right = {
            "format": PREDICTIONS_FORMAT,
            "format_version": PREDICTIONS_FORMAT_VERSION,
            "object": about.object,
            "split": about.split,
            "fingerprint": about.fingerprint,
            "group_sha256": group_sha256(about.symmetry_group),
        }
        return {**right, "grid_sha256": grid_sha256(level)} if level is not None and is_level(level) else right

    def _is_readable(self, name: str, facts: DatasetFacts) -> bool:
        foreign = [str(number) for number in facts.filters if number not in FILTERS]
        reason = ""
        known = [IMAGE_INDEX, *self._track_of_dataset]
        if name not in known:
            reason = f"is not part of the format{mend_of_name(name, known)}"
        elif facts.found:
            reason = f"is {facts.found}, where a data set of numbers in this file belongs"
        elif foreign:
            reason = f"is stored with HDF5's filter {', '.join(foreign)}; use {', '.join(FILTERS.values())} only"
        elif facts.chunk_bytes > MAX_CHUNK_BYTES:
            reason = f"has chunks of {facts.chunk_bytes / 2**20:.0f} MiB; at most {MAX_CHUNK_BYTES >> 20} are read"
        if reason:
            self.faults.add(self._track_of(name), f"{shown(name)} {reason}")
        return not reason

    def _read_image_index(self) -> npt.NDArray[np.int64] | None:
        expected, split = len(self.about), self.about.split
        if not self.is_shaped(IMAGE_INDEX, INTEGERS, ("N",)):
            return None
        count = self._facts[IMAGE_INDEX].shape[0]
        if count > 2 * expected + 1000:
            self.faults.add(THE_FILE, f"has {count} rows; the {split} split has {expected} images")
            return None
        image_index = self.read_integers(IMAGE_INDEX)
        if image_index is None:
            return None
        is_strange = (image_index < 0) | (image_index >= expected)
        seen = np.bincount(image_index[~is_strange], minlength=expected)
        counts_from_1 = np.array_equal(np.sort(image_index), np.arange(1, expected + 1))
        found = {
            "{} of the {} images are missing": np.flatnonzero(seen == 0),
            "{} of the {} images are there more than once": np.flatnonzero(seen > 1),
            "{} rows are about images outside the {} of the split": image_index[is_strange],
        }
        for what, which in found.items():
            if len(which):
                some = ", ".join(str(i) for i in which[:5]) + (", ..." if len(which) > 5 else "")
                mend = "; images count from 0: subtract 1" if counts_from_1 else ""
                self.faults.add(THE_FILE, f"{IMAGE_INDEX!r}: {what.format(len(which), expected)}: {some}{mend}")
        return None if any(map(len, found.values())) else image_index
