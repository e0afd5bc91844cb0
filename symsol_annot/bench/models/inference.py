"""From a trained model to a predictions file, in float32 on any device."""

import hashlib
from pathlib import Path

import torch

import symsol_annot
from symsol_annot.bench.models.devices import full_precision
from symsol_annot.bench.models.kinds import kind_of
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.training.checkpoints import Checkpoint
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets.dataset import Dataset


def predict(
    checkpoint: Checkpoint,
    dataset: Dataset,
    path: Path,
    device: torch.device,
    *,
    method: str | None = None,
    level: int = STANDARD_LEVEL,
) -> tuple[str, ...]:
    """Write a model's predictions about a split; where that was stopped, the same model goes on with what is left.

    Args:
        checkpoint: of the model.
        dataset: the whole split.
        path: of the predictions file.
        device: what the model runs on.
        method: what the file says it is by; the recipe's name by default.
        level: of the grid a classifier is asked on; only the standard one ranks.

    Returns:
        The names of the tracks.

    Raises:
        ModelError: the model was trained on another object or size of image, or the device has too little memory.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the file is there and about something else, or another model's answers are kept beside it.
        OutputError: another process writes it, or it cannot be written.
    """
    checkpoint.refuse_other_images(dataset)
    kind = kind_of(checkpoint.record.recipe)
    by, who = method or checkpoint.record.name, identity(checkpoint)
    with full_precision():
        model = checkpoint.model.to(device)
        asked = Asked(by, level, who, checkpoint.record.calibration)
        kind.method.write_predictions(model, checkpoint.record.recipe, dataset, path, asked)
    return kind.tracks


def identity(checkpoint: Checkpoint) -> str:
    """Return a name of a model by what decides its answers: weights, recipe, and the version of the program that asks.

    The device does not, nor does torch's version: all compute in float32, and differ by its rounding. The checkpoint's
    path and the epochs that follow it do not either.

    Returns:
        A line for people to read, equal for equal models alone (by SHA-256).
    """
    record, digest = checkpoint.record, hashlib.sha256()
    digest.update(recipe_to_toml(record.recipe).encode())
    for name, tensor in sorted(checkpoint.model.state_dict().items()):
        digest.update(f"\0{name} {tensor.dtype} {tuple(tensor.shape)}\0".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    done = f"{record.epochs_done} of {record.epochs} epochs"
    return f"{record.name} after {done}, SHA-256 {digest.hexdigest()}, by symsol-annot {symsol_annot.__version__}"
