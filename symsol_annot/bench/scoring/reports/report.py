"""Scores as a document (scores.json), and as a CSV with a row per image; `tables` shows the document to people."""

import csv
import io
import json
import math
import re
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from symsol_annot import __version__
from symsol_annot.bench.predictions.queries import group_sha256
from symsol_annot.bench.scoring.averages import DRAWS, MIN_IMAGES, Figure
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.scorers.table import metrics_shown
from symsol_annot.bench.scoring.scoring import Headline, ObjectScores, TrackScores
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import grid_sha256

SCORES_FORMAT = "symsol-annot scores"
SCORES_FORMAT_VERSION = 1
DECIMALS = "decimals"  # the key that says to how many each image's figures were rounded
STRATA = ("all", "shown", "hidden", "barely")
_LISTS = re.compile(r"\[\n[^\[\]{}]*\]")  # innermost lists; a string holds no line break


def to_document(scores: Sequence[ObjectScores], decimals: int | None = None) -> dict[str, Any]:
    """Return the scores of one method on some objects as a JSON document.

    Args:
        scores: of each object.
        decimals: to how many the figures of single images are rounded, which makes the file smaller; None for twelve
            digits. What is averaged is not rounded.

    Raises:
        ScoresError: two files are about one object, or of different methods.
    """
    names = [one.truth.object for one in scores]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ScoresError(f"more than one of the files is about {', '.join(doubled)}; score one file per object")
    methods = sorted({one.method for one in scores})
    if len(methods) > 1:
        raise ScoresError(f"the files are of different methods ({', '.join(methods)}); score one method at a time")
    return {
        "format": SCORES_FORMAT,
        "format_version": SCORES_FORMAT_VERSION,
        "method": methods[0],
        "ranks": not any(track.warnings for one in scores for track in one.tracks.values()),
        "versions": {
            "symsol-annot": __version__,
            **{name: version(name) for name in ("numpy", "scipy", "h5py")},
        },
        "bootstrap": {"draws": DRAWS, "interval": 0.95, "min_images": MIN_IMAGES},
        "objects": {one.truth.object: _object(one, decimals) for one in scores},
    }


def _object(scores: ObjectScores, decimals: int | None) -> dict[str, Any]:
    truth = scores.truth
    document: dict[str, Any] = {
        "split": truth.split,
        "images": len(truth),
        "fingerprint": truth.fingerprint,
        "group_sha256": group_sha256(truth.labels.symmetry_group),
        "predictions": {"file": scores.file, "sha256": scores.sha256},
        "strata": {name: int(rows.sum()) for name, rows in truth.strata.items()},
    }
    for name, track in scores.tracks.items():
        level = track.facts.get("grid_level")
        document[name] = {
            "name": track.name,
            **track.facts,
            **({} if level is None else {"grid_sha256": grid_sha256(int(level))}),
            "headline": _headline(track.headline),
            "warnings": list(track.warnings),
            "notes": list(track.notes),
            **{
                stratum: {metric: _figure(figure) for metric, figure in figures.items()}
                for stratum, figures in track.figures.items()
            },
        }
    document["per_image"] = _per_image(scores, decimals)
    return document


def _headline(headline: Headline) -> dict[str, Any]:
    return {
        "metric": headline.metric,
        "value": _number(headline.value),
        "chance": _number(headline.chance),
        "best_possible": _number(headline.best_possible),
    }


def _figure(figure: Figure) -> dict[str, Any]:
    return {
        "value": _number(figure.value),
        "low": _number(figure.low),
        "high": _number(figure.high),
        "images": figure.images,
        "undefined": figure.undefined,
    }


def _per_image(scores: ObjectScores, decimals: int | None) -> dict[str, Any]:
    """Return what `compare` needs: strata, set sizes and the table's metrics of each image."""
    truth = scores.truth
    return {
        **({} if decimals is None else {DECIMALS: decimals}),
        "set_size": truth.set_sizes.tolist(),
        "strata": {name: np.flatnonzero(rows).tolist() for name, rows in truth.strata.items() if name != "all"},
        **{
            name: {
                metric: [_number(value, decimals) for value in track.per_image.values[metric].tolist()]
                for metric in _tabulated(name, track)
            }
            for name, track in scores.tracks.items()
        },
    }


def _tabulated(name: str, track: TrackScores) -> list[str]:
    """Return the metrics that tables show of a track, as far as this object has them."""
    return [metric.name for metric in metrics_shown(name, Place.TABLES) if metric.name in track.per_image.values]


def _number(value: float, decimals: int | None = None) -> float | None:
    """Return a JSON number with what digits mean something, rounded where asked; null where undefined."""
    if not math.isfinite(value):
        return None
    return float(f"{value:.12g}") if decimals is None else round(value, decimals)


def to_json(document: dict[str, Any]) -> str:
    """Return a document as JSON that a person can read down to the figures and that has one line per list."""
    text = json.dumps(document, indent=1, allow_nan=False)
    return _LISTS.sub(lambda found: re.sub(r"\n *", " ", found.group()), text) + "\n"


def per_image_csv(scores: Sequence[ObjectScores]) -> str:
    """Return a row per image, of all objects, with every metric of every track as a column."""
    columns = {
        f"{name}.{metric}": None
        for one in scores
        for name, track in one.tracks.items()
        for metric in track.per_image.values
    }
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["object", "split", "image_index", "stratum", "barely", "set_size", *columns])
    for one in scores:
        strata = one.truth.strata
        for i in range(len(one.truth)):
            stratum = next((name for name in ("shown", "hidden") if name in strata and strata[name][i]), "all")
            figures = {
                f"{name}.{metric}": _number(float(values[i]))
                for name, track in one.tracks.items()
                for metric, values in track.per_image.values.items()
            }
            barely = int("barely" in strata and strata["barely"][i])
            about = [one.truth.object, one.truth.split, i, stratum, barely, int(one.truth.set_sizes[i])]
            writer.writerow([*about, *("" if figures.get(c) is None else figures[c] for c in columns)])
    return text.getvalue()
