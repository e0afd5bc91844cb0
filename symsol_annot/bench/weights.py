"""Files of weights: read without running code, checked against a model."""

from symsol_annot.bench.models.weights.imagenet import (
    IMAGENET_URL,
    imagenet_file,
)
from symsol_annot.bench.models.weights.state_dicts import (
    load_weights,
    read_weights,
    write_weights,
)

__all__ = [
    "IMAGENET_URL",
    "imagenet_file",
    "load_weights",
    "read_weights",
    "write_weights",
]
