"""Predictions files, damaged by tools/fuzz_predictions.py, validated and scored."""

import contextlib
import resource

import forked_readers
import fuzz_predictions
import numpy as np
import valid_predictions

from attack import laws
from attack.commands import outcome_of_command
from attack.kinds import SCORING, Attempt, Kind


class Predictions(Kind):
    """Files of all tracks, stored in several ways."""

    name, cases = "predictions", 1000
    modules, bases = SCORING, ("predictions",)

    def __init__(self, root):
        folder = root / "predictions"
        self._data = folder / "data"
        self._bases = [path.read_bytes() for path in sorted((folder / "bases").iterdir())]

    def attempt(self, place, number, rng):
        path = place.case / "case.h5"
        done = fuzz_predictions.make_case(path, self._bases, rng)
        (place.case / "canary.h5").write_bytes(self._bases[0])
        if rng.random() < 0.1:
            return Attempt(done, lambda: outcome_of_command("validate", path, "--data", self._data))
        if rng.random() < 0.05:
            return Attempt(done, lambda: outcome_of_command("score", path, "--data", self._data))
        if number % 2:
            return Attempt(done, lambda: self._score(path))
        return Attempt([*done, "able to open others"], lambda: self._score_able_to_open_others(path))

    def _score_able_to_open_others(self, path):
        """Score where the kernel would let the reading process open another file, so that it must not want to."""
        with _able_to_open_others():
            return self._score(path)

    def _score(self, path):
        from symsol_annot.bench.predictions.predictions_reader import open_predictions
        from symsol_annot.bench.scoring.reports import report, tables
        from symsol_annot.bench.scoring.scoring import score

        with open_predictions(path, self._data) as found:
            scored = score(found)
            document = report.to_document([scored])
        report.to_json(document).encode()
        printed = tables.tables(document)
        if not all(line.isprintable() for line in printed.split("\n")):
            raise laws.SilentError("tables with what a terminal would obey")
        for track in scored.tracks.values():
            for name, figure in track.figures["all"].items():
                is_share = "rad" not in name and "log" not in name
                if np.isinf(figure.value) or (is_share and not (np.isnan(figure.value) or 0 <= figure.value <= 1)):
                    raise laws.SilentError(f"{name} is {figure.value}")
        return "right"


@contextlib.contextmanager
def _able_to_open_others():
    """Start reading processes by a fork, without their limit on open files."""
    child = forked_readers.hdf5_child
    limit, set_limit = child._limit, resource.setrlimit

    def limit_the_rest(memory_bytes):
        resource.setrlimit = lambda which, to: None if which == resource.RLIMIT_NOFILE else set_limit(which, to)
        limit(memory_bytes)

    child._limit = limit_the_rest
    with forked_readers.forked_children():
        yield


def make_predictions(folder):
    """Make a set and valid files about it."""
    folder.mkdir()
    valid_predictions.make_bases(folder)
