"""A scores.json, plain or packed: written, and read as a file that may have been edited; do its figures follow?"""

import gzip
import json
import os
import re
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import version_fault
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.scoring.averages import PerImage, figures
from symsol_annot.bench.scoring.metric import LEAST_DECIMALS, MOST_DECIMALS
from symsol_annot.bench.scoring.reports.report import DECIMALS, SCORES_FORMAT, SCORES_FORMAT_VERSION, STRATA, to_json
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.errors import ScoresError, bulleted
from symsol_annot.system.files import write_atomically
from symsol_annot.system.reading import GZIP_ENDING, read_bytes, read_gzip
from symsol_annot.system.text.names import (
    METHOD_NAME_RULE,
    OBJECT_NAME_RULE,
    SPLITS,
    is_method_name,
    is_object_name,
    is_split,
)

MAX_BYTES = 2**26  # unpacked; 45,000 images of seven objects have 40 MB per track
_MAX_TABLES = 2**18  # lists and tables in a file, which take 20 times their text in memory; `score` writes thousands
_MAX_IMAGES = 400_000  # of all objects together; 45,000 of each make 315,000
_LARGEST = 1e6  # no figure and no set comes near it
_SHOWN_FAULTS = 10
_LONGEST_TEXT = 2000  # characters
_WORD = re.compile(r"[\w.]{1,80}")
_ENDS = ("value", "low", "high")
_COUNTS = ("images", "undefined")
_DIGITS_LOST = 1e-9  # a scores.json has figures to twelve digits
_PACKING = 9  # zlib's best level


def write_scores(path: str | os.PathLike[str], document: dict[str, Any]) -> None:
    """Write a document as scores.json, whole or not at all; as gzip, without a date, where the name ends in .gz.

    Raises:
        OutputError: it cannot be written; what was there before stays.
    """
    data = to_json(document).encode()
    write_atomically(Path(path), gzip.compress(data, _PACKING, mtime=0) if _is_packed(path) else data)


def _is_packed(path: str | os.PathLike[str]) -> bool:
    return Path(path).name.endswith(GZIP_ENDING)


def read_scores(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scores.json, of which every name and every figure that this package uses is then known to be one.

    Args:
        path: of the file; one that ends in .gz is unpacked.

    Raises:
        ScoresError: it is missing, too large, packed or as it unpacks, no gzip, no JSON, no scores of this version, or
            damaged.
    """
    try:
        text = (read_gzip if _is_packed(path) else read_bytes)(Path(path), MAX_BYTES)
    except OSError as error:
        raise ScoresError(f"{path}: cannot be read: {error.strerror or error}") from None
    if text.count(b"[") + text.count(b"{") > _MAX_TABLES:
        raise ScoresError(f"{path}: is no scores file: it has more than {_MAX_TABLES:,} lists and tables")
    try:
        document = json.loads(text, object_pairs_hook=_table)
    except (ValueError, RecursionError) as error:  # RecursionError: lists in lists in lists
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


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the keys and values of a JSON table, of which none may stand there twice."""
    table: dict[str, Any] = {}
    for name, value in pairs:
        if name in table:
            raise ValueError(f"the key {shown(name)} stands in one table more than once")
        table[name] = value
    return table


def _faults(document: dict[str, Any]) -> Iterator[str]:
    """Yield what a comparison, a plot or a page needs of a document and does not find."""
    objects = document.get("objects")
    if not is_method_name(document.get("method")):
        yield f"'method' is no name: expected {METHOD_NAME_RULE}"
    if not isinstance(objects, dict):
        yield "'objects' is no table of scores by object"
        return
    images = 0
    for name, entry in objects.items():
        if not is_object_name(name):
            yield f"'objects' has {shown(name)}, which is no object's name: expected {OBJECT_NAME_RULE}"
            continue
        faults = list(islice(_object_faults(entry), _SHOWN_FAULTS))
        yield from (f"objects.{name}{fault}" for fault in faults)
        images += 0 if faults else entry["images"]
    if images > _MAX_IMAGES:
        yield f"'objects' are about {images:,} images together; at most {_MAX_IMAGES:,} are read"


def _object_faults(entry: Any) -> Iterator[str]:
    if not isinstance(entry, dict) or not isinstance(entry.get("per_image"), dict):
        yield " has no 'per_image'"
        return
    if not is_split(entry.get("split")):
        yield f".split: expected one of {', '.join(SPLITS)}, found {shown(entry.get('split'))}"
    if not _is_text(entry.get("fingerprint")):
        yield ".fingerprint is no text"
    images, per_image = entry.get("images", 0), entry["per_image"]
    if not _is_count(images, _LARGEST) or images == 0:
        yield ".images is no count"
        return
    sizes, strata = per_image.get("set_size"), per_image.get("strata")
    if not _are_decimals(per_image.get(DECIMALS, MOST_DECIMALS)):
        yield f".per_image.{DECIMALS}: expected {LEAST_DECIMALS} to {MOST_DECIMALS}"
    if not _is_column(sizes, images) or not all(_is_count(size, _LARGEST) and size for size in sizes):
        yield f".per_image.set_size is no list of {images} counts"
    if not isinstance(strata, dict) or not all(_are_images(rows, images) for rows in strata.values()):
        yield f".per_image.strata is no table of ascending images of {images}"
        return
    if not set(strata) <= set(STRATA[1:]):  # "all" would take the place of all images
        yield f".per_image.strata has others than {', '.join(STRATA[1:])}"
        return
    for track in (track for track in SCORINGS if track in entry):
        yield from _track_faults(track, entry[track], per_image.get(track), images, ["all", *strata])


def _track_faults(track: str, scores: Any, columns: Any, images: int, strata: list[str]) -> Iterator[str]:
    if not isinstance(scores, dict):
        yield f".{track} is no table of figures"
        return
    yield from (f".{track}{fault}" for fault in _faults_of_facts(track, scores))
    if not isinstance(columns, dict) or not columns:
        yield f".per_image.{track} is missing"
        return
    for metric, column in columns.items():
        if not _is_column(column, images) or not all(_is_figure(value) for value in column):
            yield f".per_image.{track}.{_word(metric)} is no list of {images} figures"
    for stratum in strata:
        figures = scores.get(stratum)
        if not isinstance(figures, dict):
            yield f".{track}.{stratum} is no table of figures"
            continue
        metrics = dict.fromkeys([*columns, *figures])
        yield from (
            f".{track}.{stratum}.{_word(metric)} has no value with an interval"
            for metric in metrics
            if not _is_averaged(figures.get(metric))
        )


def _faults_of_facts(track: str, scores: dict[str, Any]) -> Iterator[str]:
    """Say what is wrong with what stands beside a track's figures: its name, its M, warnings and notes."""
    faults = list(SCORINGS[track].faults_of_facts(scores))
    yield from faults
    if faults:
        return
    if scores.get("name") != (name := SCORINGS[track].name_of(scores)):
        yield f".name: expected {name!r}, found {shown(scores.get('name'))}"
    for what, found in (("warnings", scores.get("warnings")), ("notes", scores.get("notes", []))):
        if not isinstance(found, list) or not all(_is_text(line) for line in found):
            yield f".{what} is no list of texts"


def _word(metric: str) -> str:
    """Return a metric's name for a message, in quotes where it is no word."""
    return metric if _WORD.fullmatch(metric) else shown(metric)


def _is_averaged(figure: Any) -> bool:
    """Tell whether this is a figure over a stratum: a value with its interval, and over how many images it is."""
    return (
        isinstance(figure, dict)
        and all(end in figure and _is_figure(figure[end]) for end in _ENDS)
        and all(_is_count(figure.get(count), _LARGEST) for count in _COUNTS)
    )


def _are_decimals(value: Any) -> bool:
    return _is_count(value, MOST_DECIMALS + 1) and value >= LEAST_DECIMALS


def per_image_table(entry: dict[str, Any], track: str) -> PerImage:
    """Return the figures of each image that an object's scores hold of a track."""
    metrics = {metric.name: metric for metric in SCORINGS[track].metrics}
    columns = entry["per_image"][track].items()
    values = {name: np.array(column, dtype=np.float64) for name, column in columns}
    sizes = np.array(entry["per_image"]["set_size"])
    weights = {  # a name that this version does not know weighs all images alike
        name: metrics[name].weights(column, sizes) if name in metrics else np.where(np.isnan(column), 0.0, 1.0)
        for name, column in values.items()
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
    """Yield the figures of an object's scores, or ends of their intervals, that its images' figures do not give.

    What was rounded of each image moves a mean by no more than that.
    """
    strata, rounding = strata_of(entry), rounding_of(entry)
    for track in (track for track in SCORINGS if track in entry):
        for stratum, computed in figures(per_image_table(entry, track), strata).items():
            for metric, figure in computed.items():
                found = entry[track][stratum][metric]
                for end in _ENDS:
                    if not is_same_figure(found[end], value := getattr(figure, end), rounding):
                        where = f"{track}.{stratum}.{metric}.{end}"
                        yield f"{where}: says {shown(found[end])}, its images give {value:.12g}"


def rounding_of(entry: Mapping[str, Any]) -> float:
    """Return by how much the figures of an object's images may have been rounded; 0 where all digits are there."""
    decimals = entry["per_image"].get(DECIMALS)
    return 0.0 if decimals is None else 0.5 * 10.0**-decimals


def is_same_figure(said: float | None, computed: float | None, rounding: float = 0.0) -> bool:
    """Tell whether two figures are one to the digits that a scores.json has.

    Args:
        said: a figure; None is one that is undefined.
        computed: another.
        rounding: by how much one of them may be off.
    """
    a, b = (np.nan if value is None else value for value in (said, computed))
    return bool(np.isclose(a, b, _DIGITS_LOST, _DIGITS_LOST + rounding, equal_nan=True))


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and value.isprintable() and len(value) <= _LONGEST_TEXT


def _is_count(value: Any, end: float) -> bool:
    return type(value) is int and 0 <= value < end


def _is_figure(value: Any) -> bool:
    return value is None or (type(value) in (int, float) and abs(value) <= _LARGEST)  # NaN is none


def _is_column(values: Any, images: int) -> bool:
    return isinstance(values, list) and len(values) == images


def _are_images(rows: Any, images: int) -> bool:
    return isinstance(rows, list) and all(_is_count(i, images) for i in rows) and rows == sorted(set(rows))
