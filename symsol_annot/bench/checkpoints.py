"""Checkpoints: a folder of what a training has come to, in files that hold numbers and text and no code.

    weights.safetensors   the model after the last finished epoch; its metadata holds recipe and record
    best.safetensors      the same after the epoch that was best on the validation images
    state.safetensors     what training goes on from: weights, and Adam's means
    recipe.toml, metrics.csv, curve.png   to look at; nothing reads them

state.safetensors is written first and holds all of the others, so that they agree again whenever training goes on.
"""

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import roma
import safetensors
import safetensors.torch
import torch
from torch import nn

import symsol_annot
from symsol_annot.bench.devices import hardware
from symsol_annot.bench.format import version_fault
from symsol_annot.bench.metric_table import HIGHER, metric_of
from symsol_annot.bench.models import HypothesisNetwork, RotationClassifier
from symsol_annot.bench.recipe import HypothesisRecipe, Recipe, recipe_from_toml, recipe_to_toml
from symsol_annot.bench.weights import Weights, load_weights, read_weights
from symsol_annot.dataset import Dataset
from symsol_annot.errors import ModelError, SettingsError, WeightsError
from symsol_annot.files import write_atomically

WEIGHTS, BEST, STATE = "weights.safetensors", "best.safetensors", "state.safetensors"
RECIPE, METRICS, CURVE = "recipe.toml", "metrics.csv", "curve.png"
_FORMAT, _FORMAT_VERSION = "symsol-annot checkpoint", 1
_BEST_BY = {"hypotheses": "recall_mean_error_rad", "classifier": "f_measure"}  # of the epochs
_MEANS = ("exp_avg", "exp_avg_sq", "step")  # what Adam keeps of each parameter
_SETTING = ("recipe", "object", "image_size", "train_fingerprint", "epochs", "seed")  # what decides the weights

Row = dict[str, float]


@dataclass(frozen=True)
class TrainingRecord:
    """What is known of a training.

    Attributes:
        name: the recipe's.
        recipe: for the object.
        object: trained on.
        image_size: width and height.
        train_fingerprint: of the split.
        epochs: how many there are to be; the recipe's schedule is stretched or shortened to them.
        seed: of first weights, order and random rotations.
        first_stage: where it began: a file of weights by its SHA-256, or what the recipe says.
        rows: the figures of each finished epoch.
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
    """

    path: Path
    record: TrainingRecord
    model: HypothesisNetwork | RotationClassifier

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
    file = path / WEIGHTS if path.is_dir() else path
    record = read_record(file)
    model = new_model(record.recipe, None, 0)
    load_weights(model, read_weights(file), str(file), f"the weights of its recipe, {record.name}")
    return Checkpoint(file, record, model.eval())


def read_record(file: Path) -> TrainingRecord:
    """Return what a checkpoint's file says of its training, without reading the weights.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of this program's.
    """
    if not file.is_file():
        raise WeightsError(f"{file}: there is no such checkpoint; `symsol-annot train` makes one")
    try:
        with safetensors.safe_open(file, framework="pt") as content:
            metadata = content.metadata() or {}
    except (safetensors.SafetensorError, OSError, ValueError) as error:
        raise WeightsError(f"{file}: the checkpoint is damaged ({type(error).__name__}: {error})") from None
    if metadata.get("format") != _FORMAT:
        raise WeightsError(
            f"{file}: holds no recipe, so it is no checkpoint of `symsol-annot train`, whose files end in .safetensors"
        )
    found = metadata.get("format_version", "")
    if fault := version_fault(int(found) if found.isdecimal() else found, _FORMAT_VERSION):
        raise WeightsError(f"{file}: {fault}")
    try:
        return _record(metadata, str(file))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, SettingsError) as error:
        raise WeightsError(f"{file}: what it says of its training is damaged: {error}") from None


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


def restore(folder: Path, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Give model and optimiser what `save` wrote.

    Raises:
        WeightsError: it is damaged or another model's; the message says what to do.
    """
    file = folder / STATE
    found = read_weights(file)
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
    known = [(sign * row[best_by.name], epoch) for epoch, row in enumerate(record.rows, 1) if best_by.name in row]
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
    known: dict[str, Any] = json.loads(metadata["record"])
    width, height = (int(side) for side in known["image_size"])
    return TrainingRecord(
        name=str(known["name"]),
        recipe=recipe_from_toml(metadata["recipe"], source),
        object=str(known["object"]),
        image_size=(width, height),
        train_fingerprint=str(known["train_fingerprint"]),
        epochs=int(known["epochs"]),
        seed=int(known["seed"]),
        first_stage=str(known["first_stage"]),
        rows=tuple({str(name): float(value) for name, value in row.items()} for row in known["rows"]),
        software={str(name): str(value) for name, value in known["software"].items()},
    )
