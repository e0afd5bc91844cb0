"""From a trained model to a predictions file, in float32 unless bfloat16 is asked for."""

import hashlib
from pathlib import Path

import torch

import symsol_annot
from symsol_annot.bench.models.devices import full_precision, products_precision
from symsol_annot.bench.models.kinds import MODEL_KINDS, ModelKind, kind_of
from symsol_annot.bench.models.methods.method import BALANCED, HYPOTHESES, Asked
from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.recipe_keys import FLOAT32
from symsol_annot.bench.models.training.checkpoints import Checkpoint
from symsol_annot.errors import SettingsError
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
    precision: str = FLOAT32,
    is_compiled: bool = False,
    hypotheses: str = BALANCED,
) -> tuple[str, ...]:
    """Write a model's predictions about a split; where that was stopped, the same model goes on with what is left.

    Args:
        checkpoint: of the model.
        dataset: the whole split.
        path: of the predictions file.
        device: what the model runs on.
        method: what the file says it is by; the recipe's name by default.
        level: of the grid a classifier is asked on; only the standard one ranks.
        precision: of the matrix products that score rotations: "float32", "bfloat16", or "auto", bfloat16 on a CPU that
            computes in it. Kinds of models that score none compute in float32.
        is_compiled: whether torch.compile works on what scores rotations, which makes bfloat16 faster.
        hypotheses: of a mixture: "balanced"; "covering", 180 that leave less out; or "surest", the one that is expected
            to be nearest to the set. The last two are written alone.

    Returns:
        The names of the tracks.

    Raises:
        SettingsError: the device does not compute in that precision, torch.compile fails, or hypotheses that the
            kind of model does not choose from.
        ModelError: the model was trained on another object or size of image, or the device has too little memory.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the file is there and about something else, or another model's answers are kept beside it.
        OutputError: another process writes it, or it cannot be written.
    """
    checkpoint.refuse_other_images(dataset)
    kind = kind_of(checkpoint.record.recipe)
    _refuse_hypotheses(kind, hypotheses)
    products = products_precision(device, precision) if kind.scores_rotations else FLOAT32
    chosen = "" if hypotheses == BALANCED else f"-{hypotheses}"
    by, who = method or checkpoint.record.name + chosen, identity(checkpoint, products, hypotheses)
    with full_precision():
        model = checkpoint.model.to(device)
        asked = Asked(by, level, who, checkpoint.record.calibration, products, is_compiled, hypotheses)
        kind.method.write_predictions(model, checkpoint.record.recipe, dataset, path, asked)
    return kind.tracks if hypotheses == BALANCED else ("hypotheses",)


def _refuse_hypotheses(kind: ModelKind, hypotheses: str) -> None:
    if hypotheses not in HYPOTHESES:
        raise SettingsError(f"hypotheses: expected {', '.join(HYPOTHESES)}, found {hypotheses!r}")
    if hypotheses != BALANCED and not kind.chooses_hypotheses:
        able = ", ".join(known.name for known in MODEL_KINDS.values() if known.chooses_hypotheses)
        raise SettingsError(
            f"hypotheses: {hypotheses!r} can be asked of a model of the kind {able}, and this is of the kind "
            f"{kind.name}; leave it out"
        )


def identity(checkpoint: Checkpoint, products: str = FLOAT32, hypotheses: str = BALANCED) -> str:
    """Return a name of a model by what decides its answers: weights, recipe, precision, and the program's version.

    The device does not, nor does torch's version: they differ by rounding. The checkpoint's path and the epochs that
    follow it do not either.

    Args:
        checkpoint: of the model.
        products: the precision of the matrix products that score rotations.
        hypotheses: which are listed.

    Returns:
        A line for people to read, equal for equal models alone (by SHA-256).
    """
    record, digest = checkpoint.record, hashlib.sha256()
    digest.update(recipe_to_toml(record.recipe).encode())
    for name, tensor in sorted(checkpoint.model.state_dict().items()):
        digest.update(f"\0{name} {tensor.dtype} {tuple(tensor.shape)}\0".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    done = f"{record.epochs_done} of {record.epochs} epochs"
    by = f"symsol-annot {symsol_annot.__version__}" + ("" if products == FLOAT32 else f" in {products}")
    by += "" if hypotheses == BALANCED else f", {hypotheses} hypotheses"
    return f"{record.name} after {done}, SHA-256 {digest.hexdigest()}, by {by}"
