"""Methods side by side: their scores, and paired bootstrap differences from the first."""

import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.averages import PerImage, difference
from symsol_annot.bench.report import SCORES_FORMAT, SCORES_FORMAT_VERSION, STRATA, TABLE, aligned, short
from symsol_annot.bench.structure import shown
from symsol_annot.errors import ScoresError

_MAX_BYTES = 2**28
_POOLED = ("recall_mean_error_rad", "coverage_at_5_deg")
_LARGEST = 1e6  # no figure and no set comes near it
_SHOWN_FAULTS = 10


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
    if document.get("format_version") != SCORES_FORMAT_VERSION:
        found = shown(document.get("format_version"))
        raise ScoresError(f"{path}: this version reads format_version {SCORES_FORMAT_VERSION}, found {found}")
    faults = list(islice(_faults(document), _SHOWN_FAULTS))
    if faults:
        lines = "\n".join(f"  - {fault}" for fault in faults)
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
    for track in (track for track in TABLE if track in entry):
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
            if not isinstance(figure, dict) or "value" not in figure or not _is_figure(figure["value"]):
                yield f".{track}.{stratum}.{metric} has no value"


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


def compare(paths: Sequence[Path]) -> str:
    """Return tables of the scores files side by side, object by object and track by track.

    Raises:
        ScoresError: a file is broken, or they are about different images.
    """
    documents = [read_scores(path) for path in paths]
    shared = [name for name in documents[0]["objects"] if all(name in other["objects"] for other in documents)]
    if not shared:
        raise ScoresError("the files have no object in common")
    tables = []
    for name in shared:
        entries = [document["objects"][name] for document in documents]
        for entry, path in zip(entries, paths, strict=True):
            _refuse_other_images(name, entries[0], paths[0], entry, path)
        for track in TABLE:
            sides = [(d["method"], entry) for d, entry in zip(documents, entries, strict=True) if track in entry]
            if len(sides) > 1:
                tables.append(_compare_track(name, track, sides))
    if not tables:
        raise ScoresError("the files have no track in common")
    return "\n\n".join(tables)


def _refuse_other_images(name: str, a: dict[str, Any], a_path: Path, b: dict[str, Any], b_path: Path) -> None:
    for what in ("split", "fingerprint", "images"):
        if a[what] != b[what]:
            raise ScoresError(
                f"{name}: {a_path} is about {what} {a[what]!r}, {b_path} about {b[what]!r}; "
                "only scores on the same images can be compared"
            )
    for what in ("set_size", "strata"):
        if a["per_image"][what] != b["per_image"][what]:
            raise ScoresError(f"{name}: {a_path} and {b_path} differ in per_image.{what} of the same images")


def _compare_track(name: str, track: str, sides: list[tuple[str, dict[str, Any]]]) -> str:
    tables = [_per_image(track, entry) for _, entry in sides]
    metrics = [metric for metric, _, _ in TABLE[track] if all(metric in table.values for table in tables)]
    if not metrics:
        raise ScoresError(f"{name}, {track}: the files have no metric in common")
    strata = _strata(sides[0][1])
    differences = [difference(tables[0].select(metrics), other.select(metrics), strata) for other in tables[1:]]
    titles = {metric: title for metric, title, _ in TABLE[track]}
    first = f"{sides[0][0]}: {sides[0][1][track]['name']}"
    lines = [f"{name}, {track}; differences from {first}, with the 95% interval of the paired bootstrap"]
    labels = [f"{method}: {entry[track]['name']}" for method, entry in sides]
    for stratum in (s for s in STRATA if s in strata):
        rows = [
            [
                f"{stratum} ({int(strata[stratum].sum())})",
                labels[0],
                *(x for label in labels[1:] for x in (label, "difference")),
            ]
        ]
        for metric in metrics:
            cells = [_value(sides[0][1][track][stratum][metric])]
            for (_, entry), made in zip(sides[1:], differences, strict=True):
                figure = made[stratum][metric]
                cells += [_value(entry[track][stratum][metric]), _difference(figure.value, figure.low, figure.high)]
            rows.append([titles[metric], *cells])
        lines += ["", *aligned(rows)]
    for method, entry in sides:
        lines += [f"WARNING, {method}: {warning}" for warning in entry[track]["warnings"]]
    return "\n".join(lines)


def _per_image(track: str, entry: dict[str, Any]) -> PerImage:
    columns = entry["per_image"][track]
    values = {metric: np.array(column, dtype=np.float64) for metric, column in columns.items()}
    sizes = np.array(entry["per_image"]["set_size"], dtype=np.float64)
    weights = {
        metric: np.where(np.isnan(column), 0.0, sizes if metric in _POOLED else 1.0)
        for metric, column in values.items()
    }
    return PerImage(np.arange(entry["images"]), values, weights)


def _strata(entry: dict[str, Any]) -> dict[str, npt.NDArray[np.bool_]]:
    strata = {"all": np.ones(entry["images"], dtype=bool)}
    for name, images in entry["per_image"]["strata"].items():
        strata[name] = np.zeros(entry["images"], dtype=bool)
        strata[name][np.array(images, dtype=int)] = True
    return strata


def _value(figure: dict[str, Any]) -> str:
    return "-" if figure["value"] is None else short(figure["value"])


def _difference(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return "-"
    return short(value, "+") + ("" if np.isnan(low) else f" [{short(low, '+')}, {short(high, '+')}]")
