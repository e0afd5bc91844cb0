"""From a trained model to a predictions file, in float32 on any device."""

import hashlib
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

import symsol_annot
from symsol_annot.bench.models.networks.heads import HypothesisNetwork, RotationClassifier
from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.training.checkpoints import Checkpoint
from symsol_annot.bench.models.training.data import decoded
from symsol_annot.bench.models.training.devices import full_precision, largest_that_fits
from symsol_annot.bench.models.training.learners import all_hypotheses, embedded, probabilities
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_hypotheses
from symsol_annot.errors import ModelError
from symsol_annot.rotations.grid import STANDARD_LEVEL, grid_size
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

_BATCH_SIZE = 64
_BLOCK = 512  # images decoded at once


def predict(
    checkpoint: Checkpoint,
    dataset: Dataset,
    path: Path,
    device: torch.device,
    *,
    method: str | None = None,
    level: int = STANDARD_LEVEL,
) -> str:
    """Write a model's predictions about a split; where that was stopped, the same model goes on with what is left.

    Args:
        checkpoint: of the model.
        dataset: the whole split.
        path: of the predictions file.
        device: what the model runs on.
        method: what the file says it is by; the recipe's name by default.
        level: of the grid a classifier is asked on; only the standard one ranks.

    Returns:
        The track: "hypotheses" or "classifier".

    Raises:
        ModelError: the model was trained on another object or size of image, or the device has too little memory.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the file is there and about something else, or another model's answers are kept beside it.
        OutputError: another process writes it, or it cannot be written.
    """
    checkpoint.refuse_other_images(dataset)
    by, who, model = method or checkpoint.record.name, identity(checkpoint), checkpoint.model.to(device)
    with full_precision():
        if isinstance(model, HypothesisNetwork):
            write_hypotheses(path, dataset, _hypotheses_of(model, dataset), method=by, resume=who)
            return "hypotheses"
        classify = _asked_about(model, dataset, device)
        write_classifier(path, dataset, classify, method=by, level=level, batch_size=grid_size(level), resume=who)
        return "classifier"


def identity(checkpoint: Checkpoint) -> str:
    """Name a model by what decides its answers: weights, recipe, and the version of the program that asks it.

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


def _hypotheses_of(model: HypothesisNetwork, dataset: Dataset) -> Callable[[int], npt.NDArray[np.float32]]:
    """Return a callable from an image's index to its hypotheses (M, 3, 3); it is quick for one image after another."""

    @lru_cache(maxsize=1)
    def of_block(block: int) -> npt.NDArray[np.float32]:
        images = decoded(dataset[block * _BLOCK : (block + 1) * _BLOCK]).images
        return _as_memory_allows(partial(all_hypotheses, model, images))

    return lambda i: of_block(i // _BLOCK)[i % _BLOCK]


def _asked_about(
    model: RotationClassifier, dataset: Dataset, device: torch.device
) -> Callable[[int, Rotations], npt.NDArray[np.float32]]:
    """Return a callable from an image's index and rotations (n, 3, 3) to probabilities (n,)."""

    @lru_cache(maxsize=1)
    def embedding_of(i: int) -> Tensor:
        return embedded(model, torch.from_numpy(dataset[i].image)[None], 1)[0]

    def classify(i: int, R: Rotations) -> npt.NDArray[np.float32]:
        on_device = torch.from_numpy(R.astype(np.float32)).to(device)
        answers: npt.NDArray[np.float32] = probabilities(model, embedding_of(i), on_device).cpu().numpy()
        return answers

    return classify


def _as_memory_allows(run: Callable[[int], npt.NDArray[np.float32]]) -> npt.NDArray[np.float32]:
    """Run with the largest batch that memory holds; answers do not depend on it."""
    fitting = largest_that_fits(run, _BATCH_SIZE)
    if fitting is None:
        raise ModelError(
            "the GPU's memory does not hold the network and a single image; end what else uses it, or take --device cpu"
        )
    return fitting[1]
