"""What torch's data loaders take: datasets, samplers and collation, of the extra `bench`."""

from symsol_annot.sets.torch import (
    LAYOUTS,
    ShuffledShards,
    SymsolDataset,
    padded_symmetry_sets,
)

__all__ = [
    "LAYOUTS",
    "ShuffledShards",
    "SymsolDataset",
    "padded_symmetry_sets",
]
