"""The reference models, which are trained and asked for predictions; their names are imported at first use."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symsol_annot.bench.models.networks.heads import (
        FREQUENCIES,
        HIDDEN_SIZE,
        HypothesisNetwork,
        RotationClassifier,
        gram_schmidt,
        initialise,
        positional_encoding,
    )

__all__ = [
    "FREQUENCIES",
    "HIDDEN_SIZE",
    "HypothesisNetwork",
    "RotationClassifier",
    "gram_schmidt",
    "initialise",
    "positional_encoding",
]


def __getattr__(name: str) -> Any:
    """Import a model when it is first asked for: recipes are read without torch."""
    if name in __all__:
        return getattr(import_module("symsol_annot.bench.models.networks.heads"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
