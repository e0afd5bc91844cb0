"""Writers of predictions files."""

from symsol_annot.bench.predictions.tracks.classifier import DEFAULT_FLOOR
from symsol_annot.bench.predictions.writing.asked import DEFAULT_BATCH, DEFAULT_DENSITY_FLOOR
from symsol_annot.bench.predictions.writing.submission import (
    write_classifier,
    write_columns,
    write_density,
    write_hypotheses,
)

__all__ = [
    "DEFAULT_BATCH",
    "DEFAULT_DENSITY_FLOOR",
    "DEFAULT_FLOOR",
    "write_classifier",
    "write_columns",
    "write_density",
    "write_hypotheses",
]
