"""The baseline that needs no training: each test image is answered with the rotations of the nearest train images."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
import numpy.typing as npt

import symsol_annot
from symsol_annot.bench.models.methods.mixture.claims import CLAIM_LOGIT
from symsol_annot.bench.models.retrieval.embedding import embed_dataset
from symsol_annot.bench.models.retrieval.fitting import fit_bandwidths, fit_claims
from symsol_annot.bench.models.retrieval.view_density import (
    Bandwidths,
    Cells,
    ClaimRule,
    Floats,
    ViewDensity,
    weights_of,
)
from symsol_annot.bench.models.retrieval.view_index import QUARTER_TURNS, ViewIndex
from symsol_annot.bench.predictions.writing.listed import write_cells, write_claims
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.errors import DataError
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

DEFAULT_SIZE = 16
METHOD = "retrieval"
_VIEWS = 128  # per image
_FITTED = 500  # train images that are left out
_LEAST_IMAGES = 8
_FLOOR_SLACK = 1.001  # cells of the uniform share alone are not stored, and share what is left


@dataclass(frozen=True)
class Retrieved:
    """What was written, and what was fitted on train images left out of the views one at a time.

    Attributes:
        tracks: the names of the tracks.
        bandwidths: of the densities.
        log_density: their mean ln p at the rotations of the images left out, relative to the uniform density.
        rule: of claims; None where there are none.
        f_measure: the mean of it over the images left out; None where there are no claims.
    """

    tracks: tuple[str, ...]
    bandwidths: Bandwidths
    log_density: float
    rule: ClaimRule | None
    f_measure: float | None


def retrieve(
    test: Dataset,
    train: Dataset,
    path: Path,
    *,
    size: int = DEFAULT_SIZE,
    method: str = METHOD,
    level: int = STANDARD_LEVEL,
    on_images: Callable[[int], object] = int,
) -> Retrieved:
    """Write what the nearest train images say of each test image; where that was stopped, the same call goes on.

    Claims are written where the train images have symmetry sets, on which their threshold is fitted, and the test is
    not sealed. Nothing else is taken from symmetry sets or the group.

    Args:
        test: the whole split that is predicted.
        train: the whole split of views of known rotation.
        path: of the predictions file.
        size: that images are reduced to, in pixels.
        method: what the file says it is by.
        level: of the grid; only the standard one ranks.
        on_images: is told how many more images are read.

    Raises:
        DataError: the splits are of different objects, the views are too few or are the images themselves, images are
            not square, or a shard is damaged.
        SettingsError: a wrong size or level.
        NotAnnotatedError: the test has no symmetry sets and is not sealed.
        PredictionsError: the file is there and about something else, or another method's answers are kept beside it.
        OutputError: another process writes it, or it cannot be written.
    """
    _refuse(test, train)
    has_claims = train.is_annotated and not test.manifest.is_sealed
    known, R_gt = embed_dataset(train, size, on_images)
    index = ViewIndex(known, R_gt, 1 if train.manifest.is_imported else QUARTER_TURNS)
    left_out = np.unique(np.linspace(0, len(train) - 1, _FITTED).astype(np.int64))
    near = index.nearest(known[left_out], _VIEWS, left_out=left_out)
    bandwidths, log_density = fit_bandwidths(near, R_gt[left_out])
    cells, rule, f = Cells(level), None, None
    if has_claims:
        rule, f = fit_claims(near, bandwidths, train.labels(), left_out, cells)
    views = index.nearest(embed_dataset(test, size, on_images)[0], _VIEWS)
    weights = weights_of(views.distance, bandwidths)
    densities = [ViewDensity(R, w, bandwidths) for R, w in zip(views.rotation, weights, strict=True)]
    writing: _Writing = {
        "method": method,
        "resume": f"retrieval of {size} pixels from {train.fingerprint}, by symsol-annot {symsol_annot.__version__}",
    }
    write_hypotheses(path, test, lambda i: densities[i].hypotheses(), **writing)
    _write_grid_tracks(path, test, densities, cells, rule, _FLOOR_SLACK * bandwidths.uniform / len(cells), writing)
    tracks = ("hypotheses", "classifier", "density") if has_claims else ("hypotheses", "density")
    return Retrieved(tracks, bandwidths, log_density, rule, f)


class _Writing(TypedDict):
    """What all tracks are written with."""

    method: str
    resume: str


def _write_grid_tracks(
    path: Path,
    test: Dataset,
    densities: list[ViewDensity],
    cells: Cells,
    rule: ClaimRule | None,
    floor: float,
    writing: _Writing,
) -> None:
    """Write the claims, where there is a rule for them, and the densities."""
    level = cells.index.level
    if rule is not None:
        at_queries, on_grid = _claims(densities, rule, cells)
        write_claims(path, test, at_queries, on_grid, level=level, **writing)
    write_cells(path, test, lambda i: densities[i].on_cells(cells), floor=floor, level=level, **writing)


def _refuse(test: Dataset, train: Dataset) -> None:
    if test.object != train.object:
        raise DataError(
            f"{train.folder}: expected views of {test.object}, which {test.folder} is a set of, found {train.object}"
        )
    if test.fingerprint == train.fingerprint:
        raise DataError(f"{train.folder}: the views are the images that are asked about; take another split or set")
    if len(train) < _LEAST_IMAGES:
        raise DataError(
            f"{train.folder}: expected at least {_LEAST_IMAGES} {train.split} images to search, found {len(train)}; "
            "render more with `symsol-annot render --train N`"
        )


def _claims(
    densities: list[ViewDensity], rule: ClaimRule, cells: Cells
) -> tuple[Callable[[int, Rotations], Floats], Callable[[int], tuple[npt.NDArray[np.int64], Floats]]]:
    """Return what takes an image's index and rotations to probabilities, and its index to those near its views."""

    def probabilities(i: int, log_p: Floats) -> Floats:
        """Return what is above 0.8 where p > t."""
        logit = log_p - densities[i].log_threshold(rule) + CLAIM_LOGIT
        found: Floats = 1.0 / (1.0 + np.exp(-np.clip(logit, -80.0, 80.0)))
        return found

    def at_queries(i: int, R: Rotations) -> Floats:
        return probabilities(i, densities[i].log_density(R))

    def on_grid(i: int) -> tuple[npt.NDArray[np.int64], Floats]:
        near, log_p = densities[i].near(cells)
        return near, probabilities(i, log_p)

    return at_queries, on_grid
