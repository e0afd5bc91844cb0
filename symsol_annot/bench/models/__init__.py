"""The reference models, which are trained and asked for predictions; their names are imported at first use."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symsol_annot.bench.models.networks.hypothesis_network import HypothesisNetwork, gram_schmidt
    from symsol_annot.bench.models.networks.reference_model import initialise
    from symsol_annot.bench.models.networks.rotation_classifier import (
        FREQUENCIES,
        HIDDEN_SIZE,
        RotationClassifier,
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


_NETWORKS = "symsol_annot.bench.models.networks"
_HOMES = {
    **dict.fromkeys(("HypothesisNetwork", "gram_schmidt"), f"{_NETWORKS}.hypothesis_network"),
    "initialise": f"{_NETWORKS}.reference_model",
    **dict.fromkeys(
        ("FREQUENCIES", "HIDDEN_SIZE", "RotationClassifier", "positional_encoding"), f"{_NETWORKS}.rotation_classifier"
    ),
}


def __getattr__(name: str) -> Any:
    """Import a model when it is first asked for: recipes are read without torch."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
