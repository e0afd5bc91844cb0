"""Images of symmetric objects, each with the set of all rotations that could have produced it.

import symsol_annot
test = symsol_annot.load("data/cylO", split="test")
test[0].symmetry_set  # (k, 3, 3)
"""

__version__ = "0.1.0"

from symsol_annot.dataset import Dataset, Sample, load
from symsol_annot.errors import SymsolError
from symsol_annot.order import shuffled_order
from symsol_annot.sample import load_sample

__all__ = ["Dataset", "Sample", "SymsolError", "__version__", "load", "load_sample", "shuffled_order"]
