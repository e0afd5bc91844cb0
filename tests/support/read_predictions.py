"""What a predictions file holds, read with plain h5py."""

from itertools import pairwise

import h5py


def density_rows(path):
    """Return the indices and log-probabilities of each image's cells."""
    with h5py.File(path) as file:
        bounds = file["density_offsets"][:]
        indices, log_p = file["density_indices"][:], file["density_log_probabilities"][:]
    return [(indices[a:b], log_p[a:b]) for a, b in pairwise(bounds)]
