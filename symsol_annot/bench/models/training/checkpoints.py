"""Checkpoints: a folder of what a training has come to, in files that hold numbers and text, no code.

    weights.safetensors   the model after the last finished epoch; its metadata holds recipe and record
    best.safetensors      the model after the epoch that was best on the validation images
    state.safetensors     what training goes on from: weights, and Adam's means
    recipe.toml, metrics.csv, curve.png   to look at; nothing reads them

state.safetensors is written first and holds all of the others, so that they agree again whenever training goes on.
Each of the three states the SHA-256 of what it holds, so that a damaged one is refused.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import safetensors.torch
import torch
from torch import nn

from symsol_annot.bench.models.kinds import Recipe, kind_of
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.training.record import (
    TrainingRecord,
    best_epoch,
    figures_csv,
    record_from_metadata,
    record_to_metadata,
)
from symsol_annot.bench.models.weights.safetensors_file import Content, StateDict, read_content, read_metadata
from symsol_annot.bench.models.weights.state_dicts import load_weights
from symsol_annot.errors import ModelError, WeightsError
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.files import write_atomically

WEIGHTS_FILE, BEST_FILE, STATE_FILE = "weights.safetensors", "best.safetensors", "state.safetensors"
RECIPE_FILE, FIGURES_FILE, CURVE_FILE = "recipe.toml", "metrics.csv", "curve.png"
_MEANS = ("exp_avg", "exp_avg_sq", "step")  # what Adam keeps of each parameter
_DIGEST = "contents_sha256"  # among the metadata; files of before lack it


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
    model: ReferenceModel
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


def new_model(recipe: Recipe, pretrained: str | None, seed: int) -> ReferenceModel:
    """Return a recipe's model with first weights drawn from a seed.

    Args:
        recipe: decides the kind of model and its backbone.
        pretrained: the backbone's weights, by name or path; None for a random start.
        seed: of all other weights.

    Raises:
        WeightsError: the pretrained weights cannot be had.
    """
    return kind_of(recipe).method.new_model(recipe, pretrained, torch.Generator().manual_seed(seed))


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
        return path / WEIGHTS_FILE if path.is_dir() else path
    except OSError:  # opening it gives the reason
        return path


def read_record(file: Path) -> TrainingRecord:
    """Return what a checkpoint's file says of its training, without reading the weights.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of this program's.
    """
    with _reading_errors(file):
        metadata = read_metadata(file)
    return record_from_metadata(metadata, file)


def read_checkpoint_file(file: Path) -> tuple[TrainingRecord, Content]:
    """Return what a checkpoint's file says of its training, and all that it holds, read from the same file.

    Raises:
        WeightsError: there is no such file, it is damaged, or none of this program's.
    """
    with _reading_errors(file):
        content = read_content(file)
    record = record_from_metadata(content.metadata, file)
    stated = content.metadata.get(_DIGEST)
    if stated is not None and stated != _contents_sha256(content.metadata, content.tensors):
        raise WeightsError(f"{file}: the checkpoint is damaged: its contents have another SHA-256 than it states")
    if unknown := content.metadata.keys() - record_to_metadata(record).keys() - {_DIGEST}:  # its name may be damaged
        raise WeightsError(f"{file}: the checkpoint is damaged: none has a text {min(unknown):.64}")
    return record, content


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


def save(folder: Path, record: TrainingRecord, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
    """Write state.safetensors, whole or not at all.

    Raises:
        OutputError: it cannot be written; what was there before stays.
    """
    tensors = {f"weights/{name}": tensor for name, tensor in model.state_dict().items()}
    for name, parameter in model.named_parameters():
        known = optimizer.state.get(parameter, {})
        tensors |= {f"{mean}/{name}": known[mean] for mean in _MEANS if mean in known}
    _write(folder / STATE_FILE, tensors, record)


def publish(folder: Path, record: TrainingRecord, model: nn.Module) -> None:
    """Write what follows from the state: weights, those of the best epoch where it is the last, recipe and metrics.

    Raises:
        OutputError: one cannot be written.
    """
    _write(folder / WEIGHTS_FILE, model.state_dict(), record)
    if best_epoch(record) == record.epochs_done:
        _write(folder / BEST_FILE, model.state_dict(), record)
    write_atomically(folder / RECIPE_FILE, recipe_to_toml(record.recipe).encode())
    write_atomically(folder / FIGURES_FILE, figures_csv(record.rows).encode())


def restore(file: Path, found: StateDict, model: nn.Module, optimizer: torch.optim.Optimizer) -> None:
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
    state: dict[int, StateDict] = {}
    for number, (name, parameter) in enumerate(parameters.items()):
        means = {mean: found[f"{mean}/{name}"] for mean in _MEANS if f"{mean}/{name}" in found}
        shapes = [(), *2 * [parameter.shape]]
        if means and sorted(mean.shape for mean in means.values()) != sorted(shapes):
            raise WeightsError(f"{file}: Adam's means of {name} are not of its shape; delete the folder to begin anew")
        if means:
            state[number] = {mean: _laid_out_like(parameter, tensor) for mean, tensor in means.items()}
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _laid_out_like(parameter: torch.Tensor, tensor: torch.Tensor) -> torch.Tensor:
    """Return one of Adam's means in its parameter's order of memory, so that a step computes the same bits."""
    if tensor.shape != parameter.shape:
        return tensor
    return torch.empty_like(parameter, requires_grad=False).copy_(tensor)


def _write(path: Path, tensors: Mapping[str, torch.Tensor], record: TrainingRecord) -> None:
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    metadata = record_to_metadata(record)
    metadata[_DIGEST] = _contents_sha256(metadata, plain)
    write_atomically(path, safetensors.torch.save(plain, metadata))


def _contents_sha256(metadata: Mapping[str, str], tensors: Mapping[str, torch.Tensor]) -> str:
    """Return the digest of all texts but the digest itself, and of all tensors, each with its name."""
    digest = hashlib.sha256()
    for name in sorted(metadata.keys() - {_DIGEST}):
        digest.update(json.dumps([name, metadata[name]]).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode())
        digest.update(tensor.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()
