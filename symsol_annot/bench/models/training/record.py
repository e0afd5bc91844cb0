"""The record of a training: what decided its weights, and the figures of each epoch; kept as a file's metadata."""

import csv
import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import roma
import torch

import symsol_annot
from symsol_annot.bench.models.devices import hardware
from symsol_annot.bench.models.kinds import Recipe, kind_of
from symsol_annot.bench.models.recipe import recipe_from_toml, recipe_to_toml
from symsol_annot.bench.models.recipe_keys import MAX_EPOCHS
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.bench.predictions.format import version_fault
from symsol_annot.errors import SettingsError, WeightsError
from symsol_annot.rendering.camera import SIZE_RANGE
from symsol_annot.system.text.names import METHOD_NAME_RULE, OBJECT_NAME_RULE, is_method_name, is_object_name

_FORMAT, _FORMAT_VERSION = "symsol-annot checkpoint", 1
_SETTING = ("recipe", "object", "image_size", "train_fingerprint", "seed")  # what decides the weights, with the epochs

_MAX_TEXT, _MAX_TEXTS = 1000, 64  # characters of what a record says in words; how many figures or versions
_ALWAYS, _LARGEST_FIGURE = ("loss", "learning_rate"), 1e300
_VERSION = re.compile(r"[0-9]{1,9}")
MAX_SEED = 2**63 - 1

EpochFigures = dict[str, float]


@dataclass(frozen=True)
class TrainingRecord:
    """What is known of a training.

    Attributes:
        name: the recipe's; "" where it has none.
        recipe: for the object.
        object: trained on.
        image_size: width and height, in pixels.
        train_fingerprint: of the train split.
        epochs: how many there are to be; the recipe's schedule is stretched or shortened to them.
        seed: of the first weights, the order of images, and random rotations.
        first_stage: where it began: a trained network's folder and the SHA-256 of its weights, or what the recipe says.
        rows: the figures of each finished epoch, its number and loss among them; NaN where one is undefined.
        software: versions, and what it ran on.
        calibration: what was fitted on validation images after the last epoch, by names.
        extensions: for each time that more epochs were asked for, in that order: after how many epochs, and how many
            there were to be until then. Their schedule was that of so many; the rest is scheduled for `epochs`.
    """

    name: str
    recipe: Recipe
    object: str
    image_size: tuple[int, int]
    train_fingerprint: str
    epochs: int
    seed: int
    first_stage: str
    rows: tuple[EpochFigures, ...]
    software: Mapping[str, str]
    calibration: Mapping[str, float] = field(default_factory=dict)
    extensions: tuple[tuple[int, int], ...] = ()

    @property
    def epochs_done(self) -> int:
        """How many epochs are finished."""
        return len(self.rows)

    @property
    def is_finished(self) -> bool:
        """Whether all are."""
        return self.epochs_done == self.epochs

    def differences(self, other: "TrainingRecord") -> list[str]:
        """Say in what another training differs, a line each, so that it does not go on from this one."""
        return [
            f"{name}: there {getattr(self, name)!r}, asked for {getattr(other, name)!r}"
            for name in _SETTING
            if getattr(self, name) != getattr(other, name)
        ]

    def extended_to(self, epochs: int) -> "TrainingRecord":
        """Return the record of this training with more epochs to come; without a calibration, which is of its end."""
        extensions = (*self.extensions, (self.epochs_done, self.epochs))
        return replace(self, epochs=epochs, extensions=extensions, calibration={})


def software(device: torch.device, precision: str) -> dict[str, str]:
    """Return the versions that weights depend on, and what they were made on."""
    versions = {"symsol-annot": symsol_annot.__version__, "torch": torch.__version__, "roma": roma.__version__}
    return versions | {"numpy": np.__version__, "device": f"{device.type} {hardware(device)}", "precision": precision}


def best_epoch(record: TrainingRecord) -> int | None:
    """Return the epoch, from 1, that was best on the validation images; None where there were none."""
    kind = kind_of(record.recipe)
    sign = 1.0 if FIGURES[kind.best_by] else -1.0
    figures = [sign * row.get(kind.best_by, math.nan) for row in record.rows]
    known = [(figure, epoch) for epoch, figure in enumerate(figures, 1) if not math.isnan(figure)]
    return max(known)[1] if known else None


def figures_csv(rows: tuple[EpochFigures, ...]) -> str:
    """Return the figures of epochs as CSV: a line per epoch below their names."""
    names = dict.fromkeys(name for row in rows for name in row)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def record_from_metadata(metadata: Mapping[str, str], file: Path) -> TrainingRecord:
    """Return what a checkpoint's metadata say of its training.

    Args:
        metadata: of one of its files.
        file: whose they are, for error messages.

    Raises:
        WeightsError: they are damaged, of a later version, or no checkpoint's.
    """
    if metadata.get("format") != _FORMAT:
        raise WeightsError(
            f"{file}: holds no recipe, so it is no checkpoint of `symsol-annot train`, whose files end in .safetensors"
        )
    found = metadata.get("format_version", "")
    if fault := version_fault(int(found) if _VERSION.fullmatch(found) else found, _FORMAT_VERSION):
        raise WeightsError(f"{file}: {fault}")
    try:
        return _parsed(metadata, str(file))
    except (KeyError, ValueError, RecursionError, SettingsError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else error
        raise WeightsError(f"{file}: what it says of its training is damaged: {what}") from None


def record_to_metadata(record: TrainingRecord) -> dict[str, str]:
    """Return the texts by their names that `record_from_metadata` reads."""
    rest = {part.name: getattr(record, part.name) for part in fields(record) if part.name != "recipe"}
    for name in ("calibration", "extensions"):
        if not rest[name]:  # as in records of before there was one
            del rest[name]
    return {
        "format": _FORMAT,
        "format_version": str(_FORMAT_VERSION),
        "recipe": recipe_to_toml(record.recipe),
        "record": json.dumps(rest),
    }


def _parsed(metadata: Mapping[str, str], source: str) -> TrainingRecord:
    """Return the record that metadata hold, each part of its type and within bounds; ValueError where one is not."""
    known = json.loads(metadata["record"])
    _require(isinstance(known, dict), "expected a record's parts by their names")
    size, rows, software = known["image_size"], known["rows"], known["software"]
    _require(known["name"] == "" or is_method_name(known["name"]), f"name: expected {METHOD_NAME_RULE}")
    _require(is_object_name(known["object"]), f"object: expected {OBJECT_NAME_RULE}")
    _require(
        isinstance(size, list) and len(size) == 2 and all(_is_whole(side, *SIZE_RANGE) for side in size),
        f"image_size: expected two whole numbers from {SIZE_RANGE[0]} to {SIZE_RANGE[1]}",
    )
    _require(_is_whole(known["epochs"], 1, MAX_EPOCHS), f"epochs: expected 1 to {MAX_EPOCHS}")
    _require(_is_whole(known["seed"], 0, MAX_SEED), f"seed: expected 0 to {MAX_SEED}")
    for name in ("train_fingerprint", "first_stage"):
        _require(_is_text(known[name]), f"{name}: expected text of up to {_MAX_TEXT} characters")
    _require(
        isinstance(rows, list) and len(rows) <= known["epochs"], f"rows: expected a list of up to {known['epochs']}"
    )
    for epoch, row in enumerate(rows, 1):
        _require(
            _are_figures(row, epoch), f"rows: expected figures by their names, in a row for each epoch; not in {epoch}"
        )
    _require(
        isinstance(software, dict) and len(software) <= _MAX_TEXTS and all(map(_is_text, software.values())),
        "software: expected texts by their names",
    )
    calibration = known.get("calibration", {})
    _require(
        isinstance(calibration, dict)
        and len(calibration) <= _MAX_TEXTS
        and all(_is_text(name) and _is_figure(value) for name, value in calibration.items()),
        "calibration: expected numbers by their names",
    )
    extensions = known.get("extensions", [])
    _require(
        _are_extensions(extensions, len(rows), known["epochs"]),
        "extensions: expected pairs of epochs that were done and planned, ascending",
    )
    return TrainingRecord(
        name=known["name"],
        recipe=recipe_from_toml(metadata["recipe"], source),
        object=known["object"],
        image_size=(size[0], size[1]),
        train_fingerprint=known["train_fingerprint"],
        epochs=known["epochs"],
        seed=known["seed"],
        first_stage=known["first_stage"],
        rows=tuple({name: float(value) for name, value in row.items()} for row in rows),
        software=software,
        calibration=calibration,
        extensions=tuple((done, planned) for done, planned in extensions),
    )


def _require(is_right: bool, expected: str) -> None:  # noqa: FBT001 - a condition, and what to say where it is not met
    if not is_right:
        raise ValueError(expected)


def _is_whole(value: Any, least: int, most: int) -> bool:
    return type(value) is int and least <= value <= most


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _MAX_TEXT


def _is_figure(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= _LARGEST_FIGURE


def _are_extensions(pairs: Any, epochs_done: int, epochs: int) -> bool:
    """Tell whether each pair has no fewer epochs done than the one before and more planned, up to what there is now."""
    if not isinstance(pairs, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        return False
    least_done, least_planned = 1, 1
    for done, planned in pairs:
        if not _is_whole(planned, least_planned, epochs - 1) or not _is_whole(
            done, least_done, min(planned, epochs_done)
        ):
            return False
        least_done, least_planned = done, planned + 1
    return True


def _are_figures(row: Any, epoch: int) -> bool:
    """Tell whether this is an epoch's row: figures, of which those that every epoch has are finite."""
    if not isinstance(row, dict) or len(row) > _MAX_TEXTS or not all(map(_is_text, row)):
        return False
    if not all(
        type(value) in (int, float) and not abs(value) > _LARGEST_FIGURE for value in row.values()
    ):  # NaN may be
        return False
    return row.get("epoch") == epoch and all(math.isfinite(row.get(name, math.nan)) for name in _ALWAYS)
