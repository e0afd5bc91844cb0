"""Bit flips: `verify` finds every one, and compares checksums before HDF5 opens a file.

python tools/soak/flips.py [--flips 1000] [--manifest 200] [--seed 0]

A real set is made, and bits of its files are flipped, one at a time: some in the manifest, the others in its shards,
each bit of theirs as likely as any other. While a file has a flipped bit, HDF5 must not be asked to open it.
"""

import time
from collections import Counter, defaultdict
from contextlib import contextmanager

import h5py
import numpy as np
from outcomes import Outcome, run_alone
from processes import Site

from symsol_annot.errors import DataError
from symsol_annot.sets.verify import verify

SET = "--object tetX --train 64 --test 64 --size 64"


def prove(table, flips, manifest, seed):
    """Flip bits of all files of a set; an outcome for each file."""
    rng = np.random.default_rng(seed)
    with Site() as site:
        ended = site.render(SET, "--workers", "2").end()
        folder = site.out / "tetX"
        if ended.code != 0 or verify(folder):
            raise RuntimeError(f"there is no good set to damage: {ended.err}")
        bits = random_bits([folder / "manifest.json"], manifest, rng)
        bits |= random_bits(sorted(folder.glob("*.h5")), flips - manifest, rng)
        for path, positions in bits.items():
            table.add(flipped(path, positions))
        if verify(folder):
            raise RuntimeError("a flip was not taken back")
    return {"set": SET}


def random_bits(paths, count, rng):
    """Return positions of different bits, each bit of all files as likely as any other, by file."""
    ends = 8 * np.cumsum([path.stat().st_size for path in paths])
    bits = defaultdict(list)
    for position in np.sort(rng.choice(ends[-1], count, replace=False)):
        number = int(np.searchsorted(ends, position, side="right"))
        bits[paths[number]].append(int(position - ends[number - 1]) if number else int(position))
    return dict(bits)


def flipped(path, positions):
    """Flip some bits of a file, one at a time, and verify its set each time."""
    start, ends = time.monotonic(), Counter(end_of(path, position) for position in positions)
    wrong = [f"{count} flips: {end}" for end, count in sorted(ends.items()) if end != "found"]
    where = f"{path.name}: {len(positions)} of {8 * path.stat().st_size} bits"
    return Outcome("bit flip", where, time.monotonic() - start, f"{ends['found']} found", wrong)


def end_of(path, position):
    """Return how `verify` ends with one bit flipped."""
    with flip(path, position), never_opened(path):
        try:
            faults = verify(path.parent)
        except DataError as error:
            return "found" if str(error).startswith(str(path)) else f"a message about something else: {error}"
        except AssertionError as error:
            return str(error)
    if len(faults) == 1 and faults[0].startswith(f"{path.name}: is damaged: expected SHA-256"):
        return "found"
    return f"expected one fault that names the file, found {faults}"


@contextmanager
def flip(path, position):
    """Flip a bit in place, and flip it back."""

    def turn():
        with path.open("r+b") as file:
            file.seek(position // 8)
            byte = file.read(1)[0]
            file.seek(position // 8)
            file.write(bytes([byte ^ 1 << position % 8]))

    turn()
    try:
        yield
    finally:
        turn()


@contextmanager
def never_opened(path):
    """Raise an error where HDF5 is asked to open a file."""
    open_file = h5py.File

    def open_another(name, *arguments, **options):
        if name == path:
            raise AssertionError("HDF5 was asked to open the damaged file")
        return open_file(name, *arguments, **options)

    h5py.File = open_another
    try:
        yield
    finally:
        h5py.File = open_file


if __name__ == "__main__":
    run_alone(__doc__, "flips", prove, flips=1000, manifest=200, seed=0)
