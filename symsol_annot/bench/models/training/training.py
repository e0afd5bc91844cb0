"""Training a model by a recipe: epoch after epoch, each of them kept, so that it goes on wherever it was stopped."""

import importlib.util
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from symsol_annot.bench.models.networks.first_stage import FirstStage
from symsol_annot.bench.models.recipe import MAX_EPOCHS, ClassifierRecipe, Recipe
from symsol_annot.bench.models.training import checkpoints
from symsol_annot.bench.models.training.checkpoints import Row, TrainingRecord
from symsol_annot.bench.models.training.curve import plot_curve
from symsol_annot.bench.models.training.data import Batch, decoded, generator, training_data
from symsol_annot.bench.models.training.devices import (
    choose_device,
    full_precision,
    has_bfloat16,
    laid_out_for,
    largest_that_fits,
)
from symsol_annot.bench.models.training.learners import learner_of
from symsol_annot.bench.models.training.pretraining import best_network, trained_networks
from symsol_annot.bench.models.training.schedules import ScheduledValues, scheduled_values_at
from symsol_annot.errors import NotAnnotatedError, SettingsError, TrainingError, bulleted
from symsol_annot.sets.dataset import Dataset, Labels
from symsol_annot.system.locks import held_folder
from symsol_annot.system.reading import file_sha256
from symsol_annot.system.text.names import METHOD_NAME_RULE, is_method_name

OnStart = Callable[[TrainingRecord, int], object]
OnImages = Callable[[int], object]
OnEpoch = Callable[[TrainingRecord], object]
_STEPS_BETWEEN_CHECKS = 50  # of the loss: each makes the host wait for the GPU


@dataclass(frozen=True)
class Options:
    """How a recipe is carried out.

    Attributes:
        epochs: in place of the recipe's, whose schedule is stretched or shortened to them.
        seed: of first weights, order and random rotations.
        device: torch's name of one, or "auto".
        pretrained: hypothesis networks to choose the first stage from; empty for all that lie beside the output folder.
        is_compiled: whether torch.compile makes the first stage faster, after a minute or so.
    """

    epochs: int | None = None
    seed: int = 0
    device: str = "auto"
    pretrained: tuple[Path, ...] = ()
    is_compiled: bool = False


def train(
    recipe: Recipe,
    dataset: Dataset,
    out: Path,
    options: Options,
    *,
    name: str = "",
    on_start: OnStart = lambda *_: None,
    on_images: OnImages = lambda _: None,
    on_epoch: OnEpoch = lambda _: None,
) -> TrainingRecord:
    """Train a model, or go on with what a folder holds of the same training.

    Args:
        recipe: for the dataset's object.
        dataset: the train split.
        out: the checkpoint's folder.
        options: epochs, seed, device.
        name: of the recipe, by the rule for a method's; "" where it has none.
        on_start: told what is there already, and how many images an epoch learns from.
        on_images: told how many more images were learnt from.
        on_epoch: told of each epoch, once it is kept.

    Raises:
        SettingsError: validation images that leave none, a device that is not here, or epochs, a seed or a name that
            no checkpoint can hold.
        NotAnnotatedError: validation images, or hard negatives, without symmetry sets.
        TrainingError: a loss that is not finite, a GPU's memory that is too small, or a folder of another training.
        WeightsError: first weights that cannot be had, or a damaged checkpoint.
        OutputError: a file that cannot be written.
    """
    device = choose_device(options.device)
    record = _record(recipe, dataset, options, device, name)
    _check(recipe, dataset)
    with held_folder(out), full_precision(benchmark=device.type == "cuda"):
        run = _Run(record, dataset, out, options, device)
        on_start(run.record, run.images_an_epoch)
        while not run.record.is_finished:
            run.one_epoch(on_images)
            on_epoch(run.record)
    return run.record


class _Run:
    """A training under way."""

    def __init__(
        self, record: TrainingRecord, dataset: Dataset, out: Path, options: Options, device: torch.device
    ) -> None:
        recipe = record.recipe
        self.record, self._out, self._device = record, out, device
        state = checkpoints.read_checkpoint_file(out / checkpoints.STATE) if _is_begun(out) else None
        if state:
            _refuse_other(out, state[0], record)
        first_file, pretrained = (None, None) if state else _start_of(record, out, options)
        model = checkpoints.new_model(recipe, pretrained, record.seed)
        if first_file is not None:
            model.first_stage.load_hypothesis_network(first_file)
        self._model = laid_out_for(device, model)
        self._learner = learner_of(recipe, model, dataset.symmetry_group)
        self._optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rates[0], fused=True)
        if state:
            checkpoints.restore(out / checkpoints.STATE, state[1].tensors, model, self._optimizer)
            self.record = replace(state[0], software=record.software)
            del state  # as large as model and optimiser
            self._publish()
        elif first_file is not None:
            self.record = replace(record, first_stage=f"{first_file.parent.name}, sha256 {file_sha256(first_file)}")
        if options.is_compiled:
            model.first_stage.compile()
        learnt = len(dataset) - recipe.validation_images
        self._data = training_data(
            dataset[:learnt], recipe.batch_size, record.seed, device, with_rejected=_needs_rejected(recipe)
        )
        self._validation_images = _validation_images(dataset[learnt:]) if recipe.validation_images else None

    @property
    def images_an_epoch(self) -> int:
        """How many images an epoch learns from."""
        return self._data.batches_an_epoch() * self._data.batch_size

    def one_epoch(self, on_images: OnImages) -> None:
        """Learn from every image once, evaluate, and keep what came of it."""
        epoch, steps = self.record.epochs_done, self._data.batches_an_epoch()
        rng = generator(self._device, self.record.seed, epoch, "negatives")
        start, processor_start, images_done = time.perf_counter(), time.process_time(), 0
        total = torch.zeros((), device=self._device)
        self._model.train()
        for step, batch in enumerate(self._data.batches(epoch)):
            scheduled = self._scheduled_at(epoch + step / steps)
            loss = self._step_or_say_what_fits(batch, scheduled, rng)
            total += loss
            if (step + 1) % _STEPS_BETWEEN_CHECKS == 0:
                self._refuse_nan(float(total), epoch)
            images_done += len(batch.images)
            on_images(len(batch.images))
        self._refuse_nan(float(total), epoch)
        last = self._scheduled_at(epoch + (steps - 1) / steps)
        row = {"epoch": epoch + 1, "loss": float(total) / steps, **_as_row(self.record.recipe, last)}
        row["images_per_second"] = round(images_done / (time.perf_counter() - start), 1)
        self._refuse_nan(sum(float(tensor.float().abs().sum()) for tensor in self._kept_tensors()), epoch)
        if self._validation_images:
            row |= self._learner.evaluate(*self._validation_images)
        row["seconds"] = round(time.perf_counter() - start, 2)
        row["processor_seconds"] = round(time.process_time() - processor_start, 2)
        self.record = replace(self.record, rows=(*self.record.rows, row))
        checkpoints.save(self._out, self.record, self._model, self._optimizer)
        self._publish()

    def _kept_tensors(self) -> Iterator[Tensor]:
        yield from self._model.state_dict().values()
        for means in self._optimizer.state.values():
            yield from means.values()

    def _publish(self) -> None:
        checkpoints.publish(self._out, self.record, self._model)
        if self.record.rows and importlib.util.find_spec("matplotlib"):
            plot_curve(self._out / checkpoints.CURVE, self.record)

    def _scheduled_at(self, epoch: float) -> ScheduledValues:
        """Return what holds at an epoch of this run, which may have more or fewer than its recipe."""
        return scheduled_values_at(self.record.recipe, epoch * self.record.recipe.epochs / self.record.epochs)

    def _step_or_say_what_fits(self, batch: Batch, scheduled: ScheduledValues, rng: torch.Generator) -> Tensor:
        try:
            return self._step(batch, scheduled, rng)
        except torch.cuda.OutOfMemoryError:
            pass  # what the step held is let go only outside of this block
        self._optimizer.zero_grad(set_to_none=True)
        size = len(batch.images)
        fitting = largest_that_fits(
            lambda count: torch.autograd.backward(self._learner.losses(batch.of(slice(count)), scheduled, rng).mean()),
            size // 2,
        )
        advice = (
            f"{fitting[0]} fit: set batch_size = {fitting[0]} in a recipe of your own"
            if fitting
            else "not even one fits"
        )
        raise TrainingError(
            f"{self._device}: its memory is too small for a batch of {size} images; {advice}, end what else "
            f"uses the GPU, or take --device cpu. {self._kept()}"
        )

    def _step(self, batch: Batch, scheduled: ScheduledValues, rng: torch.Generator) -> Tensor:
        _freeze(self._model.first_stage, is_frozen=scheduled.is_frozen)
        for group in self._optimizer.param_groups:
            group["lr"] = scheduled.learning_rate
        loss = self._learner.losses(batch, scheduled, rng).mean()
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self._optimizer.step()
        return loss.detach()

    def _refuse_nan(self, value: float, epoch: int) -> None:
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss or a weight is no longer finite in epoch {epoch + 1}: a learning rate of "
                f"{self._scheduled_at(epoch).learning_rate:g} is too high for this recipe, or the images are damaged "
                f"(`symsol-annot verify` tells). {self._kept()}"
            )

    def _kept(self) -> str:
        done = self.record.epochs_done
        return f"{self._out} keeps epoch {done}" if done else "Nothing was kept, as no epoch was finished"


def _record(recipe: Recipe, dataset: Dataset, options: Options, device: torch.device, name: str) -> TrainingRecord:
    epochs = recipe.epochs if options.epochs is None else options.epochs
    if not 1 <= epochs <= MAX_EPOCHS:
        raise SettingsError(f"epochs: expected 1 to {MAX_EPOCHS}, found {epochs}")
    if not 0 <= options.seed <= checkpoints.MAX_SEED:
        raise SettingsError(f"seed: expected 0 to {checkpoints.MAX_SEED}, found {options.seed}")
    if name and not is_method_name(name):
        raise SettingsError(f"name: expected {METHOD_NAME_RULE}, found {name!r}")
    return TrainingRecord(
        name=name,
        recipe=recipe,
        object=dataset.object,
        image_size=dataset.image_size,
        train_fingerprint=dataset.fingerprint,
        epochs=epochs,
        seed=options.seed,
        first_stage=recipe.start,
        rows=(),
        software=checkpoints.software(device, "bfloat16 backbone" if has_bfloat16(device) else "float32"),
    )


def _check(recipe: Recipe, dataset: Dataset) -> None:
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
    if _needs_rejected(recipe):
        raise NotAnnotatedError(
            f"{dataset.folder}: the train split was rendered without symmetry sets, and the recipe's hard_negatives "
            "are the candidates outside of them. `symsol-annot render --annotate all` gives every split its sets; "
            "hard_negatives = 0 needs none"
        )


def _needs_rejected(recipe: Recipe) -> bool:
    return isinstance(recipe, ClassifierRecipe) and recipe.hard_negatives > 0


def _is_begun(out: Path) -> bool:
    """Tell whether a folder holds something under the name of a state: what it is, shows when it is opened."""
    return os.path.lexists(out / checkpoints.STATE)


def _refuse_other(out: Path, there: TrainingRecord, record: TrainingRecord) -> None:
    differences = there.differences(record)
    if differences:
        raise TrainingError(
            f"{out} holds another training; nothing was touched. It differs in:\n"
            + bulleted(differences)
            + "\nUse another --out folder, or delete that one."
        )


def _start_of(record: TrainingRecord, out: Path, options: Options) -> tuple[Path | None, str | None]:
    """Return the weights of a hypothesis network to begin with, and what its backbone begins with."""
    start = record.recipe.start
    if start in ("imagenet", "random"):
        return None, "imagenet" if start == "imagenet" else None
    candidates = options.pretrained or trained_networks(out.resolve().parent, record)
    return best_network(candidates, record, start), None


def _validation_images(dataset: Dataset) -> tuple[Tensor, Labels]:
    return decoded(dataset).images, dataset.labels()


def _freeze(stage: FirstStage, *, is_frozen: bool) -> None:
    if is_frozen == next(stage.parameters()).requires_grad:
        (stage.freeze if is_frozen else stage.unfreeze)()


def _as_row(recipe: Recipe, scheduled: ScheduledValues) -> Row:
    row: Row = {"learning_rate": scheduled.learning_rate}
    if isinstance(recipe, ClassifierRecipe):
        return row | {"is_frozen": float(scheduled.is_frozen)}
    if recipe.meta_loss == "ewta":
        row["winners"] = scheduled.winners
    if recipe.embedded_loss == "von-mises":
        row["concentration"] = scheduled.concentration
    return row
