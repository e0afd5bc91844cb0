"""Reading a scores.json, which may have been edited: what it says of each image, and whether its figures follow."""

import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.averages import PerImage, figures
from symsol_annot.bench.format import version_fault
from symsol_annot.bench.metric_table import METRICS, pooled_metrics
from symsol_annot.bench.report import SCORES_FORMAT, SCORES_FORMAT_VERSION, STRATA
from symsol_annot.bench.structure import shown
from symsol_annot.errors import ScoresError, bulleted

_MAX_BYTES = 2**28
_LARGEST = 1e6  # no figure and no set comes near it
_SHOWN_FAULTS = 10
_ENDS = ("value", "low", "high")
_DIGITS_LOST = 1e-9  # a scores.json has figures to twelve digits


def read_scores(path: Path) -> dict[str, Any]:
    """Read a scores.json.

    Raises:
        ScoresError: it is missing, too large, no JSON, no scores of this version, or damaged.
    """
    try:
        if path.stat().st_size > _MAX_BYTES or not path.is_file():
            raise ScoresError(f"{path}: is no scores file: a regular file of at most {_MAX_BYTES >> 20} MiB")
        document = json.loads(path.read_bytes())
    except OSError as error:
        raise ScoresError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise ScoresError(f"{path}: is no JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != SCORES_FORMAT:
        raise ScoresError(f"{path}: is no scores file ('format' is not {SCORES_FORMAT!r}); `score --json` writes one")
    if fault := version_fault(document.get("format_version"), SCORES_FORMAT_VERSION):
        raise ScoresError(f"{path}: {fault}")
    faults = list(islice(_faults(document), _SHOWN_FAULTS))
    if faults:
        lines = bulleted(faults)
        raise ScoresError(f"{path}: was edited or is damaged; `score --json` writes it again:\n{lines}")
    return document


def _faults(document: dict[str, Any]) -> Iterator[str]:
    """Yield what a comparison needs of a document and does not find."""
    objects = document.get("objects")
    if not _is_text(document.get("method")):
        yield "'method' is no name"
    if not isinstance(objects, dict) or not all(_is_text(name) for name in objects):
        yield "'objects' is no table of scores by object"
        return
    for name, entry in objects.items():
        yield from (f"objects.{name}{fault}" for fault in _object_faults(entry))


def _object_faults(entry: Any) -> Iterator[str]:
    if not isinstance(entry, dict) or not isinstance(entry.get("per_image"), dict):
        yield " has no 'per_image'"
        return
    yield from (f".{what} is no name" for what in ("split", "fingerprint") if not _is_text(entry.get(what)))
    images, per_image = entry.get("images", 0), entry["per_image"]
    if not _is_count(images, _LARGEST) or images == 0:
        yield ".images is no count"
        return
    sizes, strata = per_image.get("set_size"), per_image.get("strata")
    if not _is_column(sizes, images) or not all(_is_count(size, _LARGEST) and size for size in sizes):
        yield f".per_image.set_size is no list of {images} counts"
    if not isinstance(strata, dict) or not all(_are_images(rows, images) for rows in strata.values()):
        yield f".per_image.strata is no table of ascending images of {images}"
        return
    if not set(strata) <= set(STRATA[1:]):  # "all" would take the place of all images
        yield f".per_image.strata has others than {', '.join(STRATA[1:])}"
        return
    for track in (track for track in METRICS if track in entry):
        yield from _track_faults(track, entry[track], per_image.get(track), images, ["all", *strata])


def _track_faults(track: str, scores: Any, columns: Any, images: int, strata: list[str]) -> Iterator[str]:
    if not isinstance(scores, dict) or not _is_text(scores.get("name")):
        yield f".{track}.name is no name"
        return
    warnings = scores.get("warnings")
    if not isinstance(warnings, list) or not all(_is_text(warning) for warning in warnings):
        yield f".{track}.warnings is no list of texts"
    if not isinstance(columns, dict) or not columns:
        yield f".per_image.{track} is missing"
        return
    for metric, column in columns.items():
        if not _is_column(column, images) or not all(_is_figure(value) for value in column):
            yield f".per_image.{track}.{metric} is no list of {images} figures"
        for stratum in strata:
            figures = scores.get(stratum)
            figure = figures.get(metric) if isinstance(figures, dict) else None
            if not isinstance(figure, dict) or not all(end in figure and _is_figure(figure[end]) for end in _ENDS):
                yield f".{track}.{stratum}.{metric} has no value with an interval"


def per_image_table(entry: dict[str, Any], track: str) -> PerImage:
    """Return the figures of each image that an object's scores hold of a track."""
    columns, pooled = entry["per_image"][track], pooled_metrics(track)
    values = {metric: np.array(column, dtype=np.float64) for metric, column in columns.items()}
    sizes = np.array(entry["per_image"]["set_size"], dtype=np.float64)
    weights = {
        metric: np.where(np.isnan(column), 0.0, sizes if metric in pooled else 1.0) for metric, column in values.items()
    }
    return PerImage(np.arange(entry["images"]), values, weights)


def strata_of(entry: dict[str, Any]) -> dict[str, npt.NDArray[np.bool_]]:
    """Return which images (N,) of an object are in each stratum."""
    strata = {"all": np.ones(entry["images"], dtype=bool)}
    for name, images in entry["per_image"]["strata"].items():
        strata[name] = np.zeros(entry["images"], dtype=bool)
        strata[name][np.array(images, dtype=int)] = True
    return strata


def figures_that_differ(entry: dict[str, Any]) -> Iterator[str]:
    """Yield the figures of an object's scores, or ends of their intervals, that its images' figures do not give."""
    strata = strata_of(entry)
    for track in (track for track in METRICS if track in entry):
        for stratum, computed in figures(per_image_table(entry, track), strata).items():
            for metric, figure in computed.items():
                found = entry[track][stratum][metric]
                for end in _ENDS:
                    if not _is_same(found[end], value := getattr(figure, end)):
                        where = f"{track}.{stratum}.{metric}.{end}"
                        yield f"{where}: says {shown(found[end])}, its images give {value:.12g}"


def _is_same(said: float | None, computed: float) -> bool:
    return bool(np.isclose(np.nan if said is None else said, computed, _DIGITS_LOST, _DIGITS_LOST, equal_nan=True))


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable()


def _is_count(value: Any, end: float) -> bool:
    return type(value) is int and 0 <= value < end


def _is_figure(value: Any) -> bool:
    return value is None or (type(value) in (int, float) and abs(value) <= _LARGEST)  # NaN is none


def _is_column(values: Any, images: int) -> bool:
    return isinstance(values, list) and len(values) == images


def _are_images(rows: Any, images: int) -> bool:
    return isinstance(rows, list) and all(_is_count(i, images) for i in rows) and rows == sorted(set(rows))
