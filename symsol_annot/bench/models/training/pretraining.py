"""Which hypothesis network a classifier's first stage begins with (sections 6.3.3 and 7.4.1)."""

import math
from collections.abc import Sequence
from pathlib import Path

from symsol_annot.bench.models.kinds import kind_of
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.recipe_keys import BEST_PRECISION, BEST_RECALL
from symsol_annot.bench.models.training.checkpoints import WEIGHTS_FILE, read_record, weights_file
from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.errors import WeightsError

_ERRORS = {
    BEST_RECALL: ("recall_mean_error_rad", "precision_mean_error_rad"),
    BEST_PRECISION: ("precision_mean_error_rad", "recall_mean_error_rad"),
}
_DIGITS = 3  # to which the thesis tells errors, so that there are ties


def trained_networks(folder: Path, like: TrainingRecord) -> list[Path]:
    """Return the files of weights of finished hypothesis networks in the folders of a folder.

    Args:
        folder: of checkpoints' folders.
        like: the training that is to begin with one: networks of other images or with another backbone are left out.
    """
    found = []
    for path in sorted(folder.glob(f"*/{WEIGHTS_FILE}")):
        try:
            record = read_record(path)
        except WeightsError:  # no checkpoint
            continue
        if (
            _images_and_backbone(record) == _images_and_backbone(like)
            and record.is_finished
            and isinstance(record.recipe, HypothesisRecipe)
        ):
            found.append(path)
    return found


def best_network(paths: Sequence[Path], like: TrainingRecord, by: str) -> Path:
    """Return the file of weights with the lowest error after the last epoch; on a tie that with the lower other error.

    Args:
        paths: checkpoints of hypothesis networks, folders or files of weights in them.
        like: the training that is to begin with one.
        by: "best-recall" or "best-precision".

    Raises:
        WeightsError: there is none, one is no hypothesis network's, of other images, or was not evaluated.
    """
    if not paths:
        raise WeightsError(
            f"the recipe begins with a hypothesis network trained on {like.object}, and there is none; train one "
            "(`symsol-annot train wta-von-mises`, for 64x64 images `small-wta`), or name its folder with --pretrained"
        )
    files = [weights_file(path) for path in paths]
    errors = {}
    for file in files:
        record = read_record(file)
        _refuse_other(file, record, like)
        last = record.rows[-1] if record.rows else {}
        missing = [name for name in _ERRORS[by] if math.isnan(last.get(name, math.nan))]
        if missing and len(files) > 1:
            raise WeightsError(
                f"{file}: was trained without validation images, so that it has no {missing[0]} to choose by; "
                "name the one network to begin with by --pretrained"
            )
        errors[file] = tuple(round(last.get(name, 0.0), _DIGITS) for name in _ERRORS[by])
    return min(errors, key=lambda file: errors[file])


def _refuse_other(file: Path, record: TrainingRecord, like: TrainingRecord) -> None:
    if not isinstance(record.recipe, HypothesisRecipe):
        title = kind_of(record.recipe).title
        raise WeightsError(f"{file}: is the {title} of recipe {record.name}; expected a hypothesis network")
    for name in ("object", "image_size"):
        if getattr(record, name) != getattr(like, name):
            raise WeightsError(f"{file}: was trained on {getattr(record, name)}, the set has {getattr(like, name)}")
    if record.recipe.backbone != like.recipe.backbone:
        raise WeightsError(f"{file}: has the backbone {record.recipe.backbone}, the recipe {like.recipe.backbone}")


def _images_and_backbone(record: TrainingRecord) -> tuple[str, tuple[int, int], str]:
    return record.train_fingerprint, record.image_size, record.recipe.backbone
