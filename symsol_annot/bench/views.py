"""Which rotations fit several views of one object."""

from symsol_annot.bench.models.views import (
    in_all_views,
    probability_in_all_views,
)

__all__ = [
    "in_all_views",
    "probability_in_all_views",
]
