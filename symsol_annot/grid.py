"""The equivolumetric grid on SO(3), its frames and its nearest rotation."""

from symsol_annot.rotations.grid import (
    MAX_LEVEL,
    STANDARD_LEVEL,
    GridIndex,
    e3nn_to_grid_frame,
    equivolumetric_grid,
    grid_frame_to_e3nn,
    grid_frame_to_implicit_pdf,
    grid_sha256,
    grid_size,
    implicit_pdf_to_grid_frame,
    ring_to_nested,
)

__all__ = [
    "MAX_LEVEL",
    "STANDARD_LEVEL",
    "GridIndex",
    "e3nn_to_grid_frame",
    "equivolumetric_grid",
    "grid_frame_to_e3nn",
    "grid_frame_to_implicit_pdf",
    "grid_sha256",
    "grid_size",
    "implicit_pdf_to_grid_frame",
    "ring_to_nested",
]
