"""Imports of the original SYMSOL, and what they are measured with.

Distances are taken here from chords, by scipy, not by the package's so3.
"""

import numpy as np
from scipy.spatial.distance import cdist

from symsol_annot.symsol.importing import import_symsol

NAMES = ("tet", "cone", "cyl", "tetX")
MEMBERS = {"tet": 12, "cone": 359, "cyl": 718}
SAME_RAD = 1e-6  # float32's entries are off by 6e-8


def angles(R, others):
    """(m, k) angles in rad from each of R to each of the others: 2 arcsin of half the chord, |R - R'| / (2 sqrt 2)."""
    chords = cdist(np.asarray(R, "f8").reshape(-1, 9), np.asarray(others, "f8").reshape(-1, 9))
    return 2 * np.arcsin(np.minimum(chords / 8**0.5, 1.0))


def everything(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def imported(path, out, *names, **options):
    return {made.folder.name: made for made in import_symsol(path, out, names, **options)}
