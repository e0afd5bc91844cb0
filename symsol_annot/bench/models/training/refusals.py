"""What is refused before a training begins or goes on: images, a device, or the folder of another training."""

from pathlib import Path

import torch

from symsol_annot.bench.models.devices import hardware, has_bfloat16
from symsol_annot.bench.models.kinds import Recipe
from symsol_annot.bench.models.recipe_keys import BFLOAT16, LEAST_BFLOAT16_SIZE
from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.errors import NotAnnotatedError, SettingsError, TrainingError, bulleted
from symsol_annot.sets.dataset import Dataset


def refuse_images(recipe: Recipe, dataset: Dataset, device: torch.device) -> None:
    """Refuse a split, or a device, that a recipe cannot be trained on.

    Raises:
        SettingsError: images that are too few or too small, or a precision that the device has not.
        NotAnnotatedError: the recipe needs symmetry sets, and the split has none.
    """
    side = min(dataset.image_size)
    if recipe.input_size > side:
        raise SettingsError(
            f"{dataset.folder}: its images have {side} pixels a side, and the recipe's input_size is "
            f"{recipe.input_size}: render them with --size {recipe.input_size} or more, or take a smaller input_size"
        )
    if recipe.precision == BFLOAT16 and not has_bfloat16(device):
        raise SettingsError(
            f"precision: the recipe asks for bfloat16, which {hardware(device)} does not compute in by itself, so that "
            'it would be slower; take precision = "float32"'
        )
    if recipe.precision == BFLOAT16 and (recipe.input_size or side) < LEAST_BFLOAT16_SIZE:
        raise SettingsError(
            f"precision: bfloat16 takes images of {LEAST_BFLOAT16_SIZE} pixels or more, these have {side}; take float32"
        )
    left = len(dataset) - recipe.validation_images
    if left < 2:
        raise SettingsError(
            f"{dataset.folder}: its train split has {len(dataset)} images, of which the recipe takes "
            f"{recipe.validation_images} for validation; 2 or more have to be left. --validation-images N takes fewer"
        )
    if dataset.is_annotated:
        return
    if recipe.validation_images:
        raise NotAnnotatedError(
            f"{dataset.folder}: the train split was rendered without symmetry sets, so its validation images cannot be "
            "scored. `symsol-annot render --annotate all` gives every split its sets; --validation-images 0 trains "
            "unscored"
        )
    if recipe.needs_members:
        raise NotAnnotatedError(
            f"{dataset.folder}: the train split was rendered without symmetry sets, and the recipe learns from their "
            "members. `symsol-annot render --annotate all` gives every split its sets"
        )
    if recipe.needs_volumes:
        raise NotAnnotatedError(
            f"{dataset.folder}: the train split was rendered without symmetry sets, and the recipe's negatives_outside "
            "leaves out what falls into their volumes. `symsol-annot render --annotate all` gives every split its "
            "sets; negatives_weight needs none"
        )
    if recipe.needs_rejected_candidates:
        raise NotAnnotatedError(
            f"{dataset.folder}: the train split was rendered without symmetry sets, and the recipe's hard_negatives "
            "are the candidates outside of them. `symsol-annot render --annotate all` gives every split its sets; "
            "hard_negatives = 0 needs none"
        )


def refuse_other(out: Path, there: TrainingRecord, asked: TrainingRecord, *, may_extend: bool) -> None:
    """Refuse the folder of a training that is not the one asked for, nor one that this one extends.

    Args:
        out: the folder.
        there: what it holds.
        asked: with no epochs yet.
        may_extend: whether the number of epochs was asked for, and is not the recipe's own alone.

    Raises:
        TrainingError: they differ; the message says in what, and what to do.
    """
    more, fewer = asked.epochs > there.epochs, asked.epochs < there.epochs
    of_epochs = f"epochs: there {there.epochs}, asked for {asked.epochs}" if fewer or (more and not may_extend) else ""
    if differences := there.differences(asked):
        raise TrainingError(
            f"{out} holds another training; nothing was touched. It differs in:\n"
            + bulleted([*differences, *([of_epochs] if of_epochs else [])])
            + "\nUse another --out folder, or delete that one."
        )
    if of_epochs:
        further = (
            f"--epochs {asked.epochs} extends it"
            if more
            else f"a higher number extends it, but it is not made shorter: use another --out folder for {asked.epochs}"
        )
        raise TrainingError(
            f"{out} holds a training of {there.epochs} epochs, {there.epochs_done} of them finished, and "
            f"{asked.epochs} were asked for; nothing was touched. --epochs {there.epochs} resumes it; {further}"
        )
