"""Methods side by side: their scores, and paired bootstrap differences from the first."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.averages import PerImage, difference
from symsol_annot.bench.report import SCORES_FORMAT, SCORES_FORMAT_VERSION, STRATA, TABLE, aligned
from symsol_annot.errors import ScoresError

_MAX_BYTES = 2**28
_POOLED = ("recall_mean_error_rad", "coverage_at_5_deg")


def read_scores(path: Path) -> dict[str, Any]:
    """Read a scores.json.

    Raises:
        ScoresError: it is missing, too large, no JSON, or no scores of this version.
    """
    try:
        if path.stat().st_size > _MAX_BYTES or not path.is_file():
            raise ScoresError(f"{path}: is no scores file: a regular file of at most {_MAX_BYTES >> 20} MiB")
        document = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise ScoresError(f"{path}: cannot be read as JSON: {getattr(error, 'strerror', None) or error}") from None
    if not isinstance(document, dict) or document.get("format") != SCORES_FORMAT:
        raise ScoresError(f"{path}: is no scores file ('format' is not {SCORES_FORMAT!r}); `score --json` writes one")
    if document.get("format_version") != SCORES_FORMAT_VERSION:
        found = document.get("format_version")
        raise ScoresError(f"{path}: this version reads format_version {SCORES_FORMAT_VERSION}, found {found!r}")
    return document


def compare(paths: Sequence[Path]) -> str:
    """Return tables of the scores files side by side, object by object and track by track.

    Raises:
        ScoresError: a file is broken, or they are about different images.
    """
    documents = [read_scores(path) for path in paths]
    try:
        return "\n\n".join(_compare_objects(documents, paths))
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise ScoresError(f"a scores file was edited or is damaged: {type(error).__name__}: {error}") from None


def _compare_objects(documents: list[dict[str, Any]], paths: Sequence[Path]) -> list[str]:
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
    return tables


def _refuse_other_images(name: str, a: dict[str, Any], a_path: Path, b: dict[str, Any], b_path: Path) -> None:
    for what in ("split", "fingerprint", "images"):
        if a[what] != b[what]:
            raise ScoresError(
                f"{name}: {a_path} is about {what} {a[what]!r}, {b_path} about {b[what]!r}; "
                "only scores on the same images can be compared"
            )


def _compare_track(name: str, track: str, sides: list[tuple[str, dict[str, Any]]]) -> str:
    tables = [_per_image(track, entry) for _, entry in sides]
    metrics = [metric for metric, _, _ in TABLE[track] if all(metric in table.values for table in tables)]
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
    values = {metric: np.array([np.nan if v is None else v for v in column]) for metric, column in columns.items()}
    if any(column.shape != (entry["images"],) for column in values.values()):
        raise ValueError("per_image has another count of images")
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
    return "-" if figure["value"] is None else f"{figure['value']:.4f}"


def _difference(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return "-"
    return f"{value:+.4f}" + ("" if np.isnan(low) else f" [{low:+.4f}, {high:+.4f}]")
