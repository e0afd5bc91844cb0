"""Images of symmetric objects, each with the set of all rotations that could have produced it.

import symsol_annot
test = symsol_annot.load("data/cylO", split="test")
test[0].symmetry_set  # (k, 3, 3)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from symsol_annot.bench.scoring.memory.in_memory import score
    from symsol_annot.errors import SymsolError
    from symsol_annot.sets.dataset import Dataset, Sample, load
    from symsol_annot.sets.epoch_order import shuffled_order
    from symsol_annot.sets.sample_set import load_sample

__all__ = ["Dataset", "Sample", "SymsolError", "__version__", "load", "load_sample", "score", "shuffled_order"]

_HOMES = {
    "Dataset": "symsol_annot.sets.dataset",
    "Sample": "symsol_annot.sets.dataset",
    "SymsolError": "symsol_annot.errors",
    "load": "symsol_annot.sets.dataset",
    "load_sample": "symsol_annot.sets.sample_set",
    "score": "symsol_annot.bench.scoring.memory.in_memory",
    "shuffled_order": "symsol_annot.sets.epoch_order",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
