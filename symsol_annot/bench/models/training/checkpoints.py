"""Checkpoints: a folder of what a training has come to, in files that hold numbers and text and no code.

    weights.safetensors   the model after the last finished epoch; its metadata holds recipe and record
    best.safetensors      the same after the epoch that was best on the validation images
    state.safetensors     what training goes on from: weights, and Adam's means
    recipe.toml, metrics.csv, curve.png   to look at; nothing reads them

state.safetensors is written first and holds all of the others, so that they agree again whenever training goes on.
"""

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import roma
import safetensors.torch
import torch
from torch import nn

import symsol_annot
from symsol_annot.bench.models.networks.heads import HypothesisNetwork, RotationClassifier
from symsol_annot.bench.models.recipe import MAX_EPOCHS, HypothesisRecipe, Recipe, recipe_from_toml, recipe_to_toml
from symsol_annot.bench.models.training.devices import hardware
from symsol_annot.bench.models.weights.files import load_weights
from symsol_annot.bench.models.weights.safetensors_file import Content, Weights, read_content, read_metadata
from symsol_annot.bench.predictions.format import version_fault
from symsol_annot.bench.scoring.metric_table import HIGHER, metric_of
from symsol_annot.errors import ModelError, SettingsError, WeightsError
from symsol_annot.rendering.scene import SIZE_RANGE
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.files import write_atomically
from symsol_annot.system.text.names import METHOD_NAME_RULE, OBJECT_NAME_RULE, is_method_name, is_object_name

WEIGHTS, BEST, STATE = "weights.safetensors", "best.safetensors", "state.safetensors"
RECIPE, METRICS, CURVE = "recipe.toml", "metrics.csv", "curve.png"
_FORMAT, _FORMAT_VERSION = "symsol-annot checkpoint", 1
_BEST_BY = {"hypotheses": "recall_mean_error_rad", "classifier": "f_measure"}  # of the epochs
_MEANS = ("exp_avg", "exp_avg_sq", "step")  # what Adam keeps of each parameter
_SETTING = ("recipe", "object", "image_size", "train_fingerprint", "epochs", "seed")  # what decides the weights

_MAX_TEXT, _MAX_TEXTS = 1000, 64  # characters of what a record says in words; how many figures or versions
_ALWAYS, _LARGEST_FIGURE = ("loss", "learning_rate"), 1e300
_VERSION = re.compile(r"[0-9]{1,9}")
MAX_SEED = 2**63 - 1

Row = dict[str, float]


@dataclass(frozen=True)
class TrainingRecord:
    """What is known of a training.

    Attributes:
        name: the recipe's; "" where nobody named it.
        recipe: for the object.
        object: trained on.
        image_size: width and height.
        train_fingerprint: of the split.
        epochs: how many there are to be; the recipe's schedule is stretched or shortened to them.
        seed: of first weights, order and random rotations.
        first_stage: where it began: a file of weights by its SHA-256, or what the recipe says.
        rows: the figures of each finished epoch, its number and loss among them; NaN where one is undefined.
        software: versions, and what it ran on.
    """

    name: str
    recipe: Recipe
    object: str
    image_size: tuple[int, int]
    train_fingerprint: str
    epochs: int
    seed: int
    first_stage: str
    rows: tuple[Row, ...]
    software: Mapping[str, str]

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


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained model.

    Attributes:
        path: of its weights.
        record: what is known of its training.
        model: in eval mode, on the CPU.
        sha256: of the file that both were read from; "" for a model that was read from none.
    """

    path: Path
    record: TrainingRecord
    model: HypothesisNetwork | RotationClassifier
    sha256: str = ""

    def refuse_other_images(self, dataset: Dataset) -> None:
        """Refuse images unlike those that the model was trained on.

        Raises:
            ModelError: they are of another object or size.
        """
        record = self.record
        if record.object != dataset.object:
            raise ModelError(
                f"{self.path}: was trained on {record.object}, the set in {dataset.folder} is of {dataset.object}; "
                "name another with --data"
            )
        size = dataset.image_size
        if record.image_size != size:
            raise ModelError(
                f"{self.path}: was trained on images of {'x'.join(map(str, record.image_size))} pixels, those in "
                f"{dataset.folder} have {'x'.join(map(str, size))}; render a set with --size {record.image_size[0]}"
            )


def software(device: torch.device, precision: str) -> dict[str, str]:
    """Return the versions that weights depend on, and what they were made on."""
    versions = {"symsol-annot": symsol_annot.__version__, "torch": torch.__version__, "roma": roma.__version__}
    return versions | {"numpy": np.__version__, "device": f"{device.type} {hardware(device)}", "precision": precision}


def new_model(recipe: Recipe, pretrained: str | None, seed: int) -> HypothesisNetwork | RotationClassifier:
    """Return a recipe's model with first weights drawn from a seed; `pretrained` as in `models`."""
    rng = torch.Generator().manual_seed(seed)
    if isinstance(recipe, HypothesisRecipe):
        return HypothesisNetwork(recipe.hypotheses, pretrained=pretrained, rng=rng)
    return RotationClassifier(recipe.frequencies, pretrained=pretrained, rng=rng)


def open_checkpoint(path: Path) -> Checkpoint:
    """Return the model of a checkpoint's folder, after its last epoch, or of one of the files of weights in it.

    Raises:
        WeightsError: there is none, it is damaged, of another program, or its weights are not its recipe's.
    """
    file = weights_file(path)
    record, content = read_checkpoint_file(file)
    model = new_model(record.recipe, None, 0)
    load_weights(model, content.tensors, str(file), f"the weights of its recipe, {record.name}")
    return Checkpoint(file, record, model.eval(), content.sha256)


def weights_file(path: Path) -> Path:
    """Return the file of weights that is meant by a checkpoint's folder, or by the file itself."""
    try:
        return path / WEIGHTS if path.is_dir() else path
    except OSError:  # whoever opens it says why
        return path


def read_record(file: Path) -> TrainingRecord:
    """Return what a checkpoint's file says of its training, without reading the weights.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of this program's.
    """
    with _reading_errors(file):
        metadata = read_metadata(file)
    return _record_of(metadata, file)


def read_checkpoint_file(file: Path) -> tuple[TrainingRecord, Content]:
    """Return what a checkpoint's file says of its training, and all that it holds, read from the same file.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of this program's.
    """
    with _reading_errors(file):
        content = read_content(file)
    return _record_of(content.metadata, file), content


@contextlib.contextmanager
def _reading_errors(file: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise WeightsError(f"{file}: there is no such checkpoint; `symsol-annot train` makes one") from None
    except OSError as error:
        raise WeightsError(f"{file}: the checkpoint cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise WeightsError(
            f"{file}: the checkpoint is damaged, or none of `symsol-annot train`, whose files end in .safetensors: "
            f"{error}"
        ) from None


def _record_of(metadata: Mapping[str, str], file: Path) -> TrainingRecord:
    if metadata.get("format") != _FORMAT:
        raise WeightsError(
            f"{file}: holds no recipe, so it is no checkpoint of `symsol-annot train`, whose files end in .safetensors"
        )
    found = metadata.get("format_version", "")
    if fault := version_fault(int(found) if _VERSION.fullmatch(found) else found, _FORMAT_VERSION):
        raise WeightsError(f"{file}: {fault}")
    try:
        return _record(metadata, str(file))
    except (KeyError, ValueError, RecursionError, SettingsError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else error
        raise WeightsError(f"{file}: what it says of its training is damaged: {what}") from None


def save(folder: Path, record: TrainingRecord, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Write state.safetensors, whole or not at all.

    Raises:
        OutputError: it cannot be written; what was there before stays.
    """
    tensors = {f"weights/{name}": tensor for name, tensor in model.state_dict().items()}
    for name, parameter in model.named_parameters():
        known = optimizer.state.get(parameter, {})
        tensors |= {f"{mean}/{name}": known[mean] for mean in _MEANS if mean in known}
    _write(folder / STATE, tensors, record)


def publish(folder: Path, record: TrainingRecord, model: nn.Module) -> None:
    """Write what follows from the state: weights, those of the best epoch where it is the last, recipe and metrics.

    Raises:
        OutputError: one cannot be written.
    """
    _write(folder / WEIGHTS, model.state_dict(), record)
    if best_epoch(record) == record.epochs_done:
        _write(folder / BEST, model.state_dict(), record)
    write_atomically(folder / RECIPE, recipe_to_toml(record.recipe).encode())
    write_atomically(folder / METRICS, metrics_csv(record.rows).encode())


def restore(file: Path, found: Weights, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Give model and optimiser what `save` wrote.

    Args:
        file: where it comes from, for error messages.
        found: its tensors.
        model: takes the weights.
        optimizer: takes Adam's means.

    Raises:
        WeightsError: it is another model's; the message says what to do.
    """
    own = {name.removeprefix("weights/"): tensor for name, tensor in found.items() if name.startswith("weights/")}
    load_weights(model, own, str(file), "the weights of its recipe")
    parameters = dict(model.named_parameters())
    state: dict[int, Weights] = {}
    for number, (name, parameter) in enumerate(parameters.items()):
        means = {mean: found[f"{mean}/{name}"] for mean in _MEANS if f"{mean}/{name}" in found}
        shapes = [(), *2 * [parameter.shape]]
        if means and sorted(mean.shape for mean in means.values()) != sorted(shapes):
            raise WeightsError(f"{file}: Adam's means of {name} are not of its shape; delete the folder to begin anew")
        if means:
            state[number] = {mean: _laid_out_like(parameter, tensor) for mean, tensor in means.items()}
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def best_epoch(record: TrainingRecord) -> int | None:
    """Return the epoch, from 1, that was best on the validation images; None where there were none."""
    track = "hypotheses" if isinstance(record.recipe, HypothesisRecipe) else "classifier"
    best_by = metric_of(track, _BEST_BY[track])
    sign = 1.0 if best_by.better == HIGHER else -1.0
    figures = [sign * row.get(best_by.name, math.nan) for row in record.rows]
    known = [(figure, epoch) for epoch, figure in enumerate(figures, 1) if not math.isnan(figure)]
    return max(known)[1] if known else None


def metrics_csv(rows: tuple[Row, ...]) -> str:
    """Return the figures of epochs as CSV, a line each."""
    names = dict.fromkeys(name for row in rows for name in row)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _laid_out_like(parameter: torch.Tensor, tensor: torch.Tensor) -> torch.Tensor:
    """Return a mean in its parameter's order of memory, so that a step computes the same bits."""
    if tensor.shape != parameter.shape:
        return tensor
    return torch.empty_like(parameter, requires_grad=False).copy_(tensor)


def _write(path: Path, tensors: Mapping[str, torch.Tensor], record: TrainingRecord) -> None:
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    write_atomically(path, safetensors.torch.save(plain, _metadata(record)))


def _metadata(record: TrainingRecord) -> dict[str, str]:
    rest = {field.name: getattr(record, field.name) for field in fields(record) if field.name != "recipe"}
    return {
        "format": _FORMAT,
        "format_version": str(_FORMAT_VERSION),
        "recipe": recipe_to_toml(record.recipe),
        "record": json.dumps(rest),
    }


def _record(metadata: Mapping[str, str], source: str) -> TrainingRecord:
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
        _require(_is_row(row, epoch), f"rows: expected figures by their names, in a row for each epoch; not in {epoch}")
    _require(
        isinstance(software, dict) and len(software) <= _MAX_TEXTS and all(map(_is_text, software.values())),
        "software: expected texts by their names",
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
    )


def _require(is_right: bool, expected: str) -> None:  # noqa: FBT001 - a condition, and what to say where it is not met
    if not is_right:
        raise ValueError(expected)


def _is_whole(value: Any, least: int, most: int) -> bool:
    return type(value) is int and least <= value <= most


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _MAX_TEXT


def _is_row(row: Any, epoch: int) -> bool:
    """Tell whether this is an epoch's row: figures, of which those that every epoch has are finite."""
    if not isinstance(row, dict) or len(row) > _MAX_TEXTS or not all(map(_is_text, row)):
        return False
    if not all(
        type(value) in (int, float) and not abs(value) > _LARGEST_FIGURE for value in row.values()
    ):  # NaN may be
        return False
    return row.get("epoch") == epoch and all(math.isfinite(row.get(name, math.nan)) for name in _ALWAYS)
