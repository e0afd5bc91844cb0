"""Training a model by a recipe: epoch after epoch, each of them kept, so that it resumes after the last whole one."""

import importlib.util
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch, rolled
from symsol_annot.bench.models.devices import (
    choose_device,
    full_precision,
    laid_out_for,
    largest_that_fits,
    takes_bfloat16,
)
from symsol_annot.bench.models.kinds import Recipe, kind_of
from symsol_annot.bench.models.networks.first_stage import FirstStage
from symsol_annot.bench.models.networks.reference_model import ReferenceModel
from symsol_annot.bench.models.recipe_keys import MAX_EPOCHS, RANDOM, TRAINED_STARTS
from symsol_annot.bench.models.training import checkpoints
from symsol_annot.bench.models.training.batch_sources import generator, open_batches
from symsol_annot.bench.models.training.curve import plot_curve
from symsol_annot.bench.models.training.event_log import EVENTS_FOLDER, EventLog, check_event_log
from symsol_annot.bench.models.training.position import rate_position, stage_position
from symsol_annot.bench.models.training.pretraining import best_network, trained_networks
from symsol_annot.bench.models.training.record import MAX_SEED, EpochFigures, TrainingRecord, software
from symsol_annot.bench.models.training.refusals import refuse_images, refuse_other
from symsol_annot.bench.models.training.split_reader import SplitReader
from symsol_annot.bench.models.training.statistics import retake_statistics
from symsol_annot.errors import SettingsError, TrainingError
from symsol_annot.sets.dataset import Dataset
from symsol_annot.sets.shard.labels import Labels
from symsol_annot.system.cache import Cache
from symsol_annot.system.locks import held_folder
from symsol_annot.system.text.names import METHOD_NAME_RULE, is_method_name

OnStart = Callable[[TrainingRecord, int], object]
OnBatch = Callable[[int], object]
OnLoss = Callable[[int, float], object]
OnSteps = Callable[[int, float, float], object]  # the last step, the mean loss since the last that was told, the rate
OnEpoch = Callable[[TrainingRecord], object]
_STEPS_BETWEEN_CHECKS = 50  # of the loss: each makes the host wait for the GPU


@dataclass(frozen=True)
class Options:
    """How a recipe is carried out.

    Attributes:
        epochs: in place of the recipe's, whose schedule is stretched or shortened to them; more than a training in
            the output folder was to have extend it.
        seed: of the first weights, the order of images, and random rotations.
        device: torch's name of one, or "auto".
        pretrained: hypothesis networks to choose the first stage from; empty for all that lie beside the output folder.
        is_compiled: whether torch.compile makes the first stage faster, after a minute or so.
        workers: how many threads decode images, or processes read them where memory is too small; as many as cores by
            default, of processes up to 8. The order of images that processes read follows from their number, too.
        cache: keeps images that the recipe reduces, for the next training on them.
        has_events: whether losses and figures are written for TensorBoard, too, in a folder in the output folder.
    """

    epochs: int | None = None
    seed: int = 0
    device: str = "auto"
    pretrained: tuple[Path, ...] = ()
    is_compiled: bool = False
    workers: int | None = None
    cache: Cache | None = None
    has_events: bool = False


def train(
    recipe: Recipe,
    dataset: Dataset,
    out: Path,
    options: Options,
    *,
    name: str = "",
    on_start: OnStart = lambda *_: None,
    on_batch: OnBatch = lambda _: None,
    on_loss: OnLoss = lambda *_: None,
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
        on_batch: told of each batch how many images it has.
        on_loss: told, every 50 steps and after an epoch's last, the number of the epoch under way, from 1, and its
            mean loss up to there.
        on_epoch: told of each epoch, once it is kept.

    Raises:
        SettingsError: validation images that leave none, a device that is not here, or epochs, a seed or a name that
            no checkpoint can hold.
        NotAnnotatedError: validation images, or hard negatives, without symmetry sets.
        TrainingError: a loss that is not finite, a GPU's memory that is too small, or a folder of another training.
        WeightsError: first weights that cannot be had, or a damaged checkpoint.
        OutputError: a file that cannot be written.
        MissingExtraError: events for TensorBoard, which is not installed.
    """
    device = choose_device(options.device)
    record = new_record(recipe, dataset, options, device, name)
    refuse_images(recipe, dataset, device)
    if options.has_events:
        check_event_log()
    with held_folder(out), full_precision(benchmark=device.type == "cuda"):
        loop = TrainingLoop(record, dataset, out, options, device)
        on_start(loop.record, loop.images_per_epoch)
        with EventLog(out / EVENTS_FOLDER if options.has_events else None, loop.record, loop.steps_per_epoch) as log:
            while not loop.record.is_finished:
                loop.one_epoch(on_batch, on_loss, log.tell_steps)
                log.tell_epoch(loop.record)
                on_epoch(loop.record)
    return loop.record


class TrainingLoop:
    """A training under way: a model, its optimiser and its batches, after some of its epochs.

    Args:
        record: of the training, with no epochs yet.
        dataset: the train split.
        out: the checkpoint's folder; where it holds epochs of the same training, the loop goes on after them.
        options: how the recipe is carried out.
        device: that the model is trained on.

    Attributes:
        record: with the figures of all finished epochs.

    Raises:
        TrainingError: the folder holds another training.
        WeightsError: first weights that cannot be had, or a damaged checkpoint.
    """

    def __init__(
        self, record: TrainingRecord, dataset: Dataset, out: Path, options: Options, device: torch.device
    ) -> None:
        self.record, self._out, self._device = record, out, device
        if _is_begun(out):
            there, state = checkpoints.read_checkpoint_file(out / checkpoints.STATE_FILE)
            refuse_other(out, there, record, may_extend=options.epochs is not None)
            self._take(checkpoints.new_model(record.recipe, None, record.seed), dataset)
            checkpoints.restore(out / checkpoints.STATE_FILE, state.tensors, self._model, self._optimizer)
            del state  # as large as model and optimiser
            self.record = replace(there, software=record.software)
            self._publish()
            if there.epochs < record.epochs:  # kept with the first epoch that follows
                self.record = self.record.extended_to(record.epochs)
        else:
            model, first_stage = _first_model(record, out, options)
            self.record = replace(record, first_stage=first_stage)
            self._take(model, dataset)
        if options.is_compiled:
            self._model.first_stage.compile()
        recipe = record.recipe
        learnt = len(dataset) - recipe.validation_images
        reader = SplitReader(recipe.input_size, options.workers, options.cache)
        self._source = open_batches(
            dataset[:learnt],
            recipe.batch_size,
            record.seed,
            device,
            reader=reader,
            with_rejected=recipe.needs_rejected_candidates,
            with_members=recipe.needs_members,
            with_volumes=recipe.needs_volumes,
        )
        self._validation_images = _validation_images(dataset[learnt:], reader) if recipe.validation_images else None

    def _take(self, model: ReferenceModel, dataset: Dataset) -> None:
        """Take a model to the device, and make what trains it."""
        recipe = self.record.recipe
        self._model = laid_out_for(self._device, model)
        self._learner = kind_of(recipe).method.learner(recipe, self._model, dataset.symmetry_group)
        self._optimizer = torch.optim.Adam(self._model.parameters(), lr=recipe.learning_rates[0], fused=True)

    @property
    def images_per_epoch(self) -> int:
        """How many images an epoch learns from."""
        return self.steps_per_epoch * self._source.batch_size

    @property
    def steps_per_epoch(self) -> int:
        """How many steps an epoch has."""
        return self._source.batches_per_epoch()

    def one_epoch(self, on_batch: OnBatch, on_loss: OnLoss, on_steps: OnSteps = lambda *_: None) -> None:
        """Learn from every image once, evaluate, and keep what came of it."""
        epoch, steps = self.record.epochs_done, self.steps_per_epoch
        rng = generator(self._device, self.record.seed, epoch, "negatives")
        start, processor_start, images_done = time.perf_counter(), time.process_time(), 0
        total, told, told_steps = torch.zeros((), device=self._device), 0.0, 0
        self._model.train()
        for step, batch in enumerate(self._source.batches(epoch)):
            loss = self._step_or_say_what_fits(batch, epoch + step / steps, rng)
            total, done = total + loss, step + 1
            if done % _STEPS_BETWEEN_CHECKS == 0 or done == steps:
                so_far = float(total)
                self._refuse_nan(so_far, epoch)
                on_loss(epoch + 1, so_far / done)
                mean, rate = (so_far - told) / (done - told_steps), self._learning_rate_at(epoch + step / steps)
                on_steps(epoch * steps + done, mean, rate)
                told, told_steps = so_far, done
            images_done += len(batch.images)
            on_batch(len(batch.images))
        figures: EpochFigures = {"epoch": epoch + 1, "loss": float(total) / steps}
        figures |= self._scheduled_figures(epoch + (steps - 1) / steps)
        figures["images_per_second"] = round(images_done / (time.perf_counter() - start), 1)
        self._refuse_nan(sum(float(tensor.float().abs().sum()) for tensor in self._kept_tensors()), epoch)
        if self.record.recipe.statistics_images:
            self._retake_statistics(epoch)
        if self._validation_images:
            figures |= self._learner.evaluate(*self._validation_images)
        calibration: dict[str, float] = {}
        if self._validation_images and epoch + 1 == self.record.epochs:
            calibration = self._learner.calibrate(*self._validation_images)
        figures["seconds"] = round(time.perf_counter() - start, 2)
        figures["processor_seconds"] = round(time.process_time() - processor_start, 2)
        self.record = replace(self.record, rows=(*self.record.rows, figures), calibration=calibration)
        checkpoints.save(self._out, self.record, self._model, self._optimizer)
        self._publish()

    def _retake_statistics(self, epoch: int) -> None:
        """Evaluate with the statistics of images as the epoch had them, its first, all at once."""
        recipe, parts, count = self.record.recipe, list[Tensor](), 0
        for batch in self._source.batches(epoch):
            parts.append((rolled(batch) if recipe.rolls else batch).images)
            count += len(parts[-1])
            if count >= recipe.statistics_images:
                break
        retake_statistics(self._model.first_stage, torch.cat(parts)[: recipe.statistics_images])

    def _kept_tensors(self) -> Iterator[Tensor]:
        yield from self._model.state_dict().values()
        for means in self._optimizer.state.values():
            yield from means.values()

    def _publish(self) -> None:
        checkpoints.publish(self._out, self.record, self._model)
        if self.record.rows and importlib.util.find_spec("matplotlib"):
            plot_curve(self._out / checkpoints.CURVE_FILE, self.record)

    def _learning_rate_at(self, epoch: float) -> float:
        return self.record.recipe.learning_rate_at(rate_position(self.record, epoch))

    def _scheduled_figures(self, epoch: float) -> EpochFigures:
        """Return what the recipe schedules at an epoch of this training."""
        stage = stage_position(self.record, epoch)
        return {"learning_rate": self._learning_rate_at(epoch), **self.record.recipe.figures_at(stage)}

    def _step_or_say_what_fits(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:
        try:
            return self._step(batch, epoch, rng)
        except torch.cuda.OutOfMemoryError:
            pass  # what the step held is let go only outside of this block
        self._optimizer.zero_grad(set_to_none=True)
        size, stage = len(batch.images), stage_position(self.record, epoch)
        fitting = largest_that_fits(
            lambda count: torch.autograd.backward(self._learner.losses(batch.rows(slice(count)), stage, rng).mean()),
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

    def _step(self, batch: Batch, epoch: float, rng: torch.Generator) -> Tensor:
        recipe, stage = self.record.recipe, stage_position(self.record, epoch)
        _freeze(self._model.first_stage, is_frozen=recipe.is_frozen_at(stage))
        for group in self._optimizer.param_groups:
            group["lr"] = self._learning_rate_at(epoch)
        loss = self._learner.losses(rolled(batch) if recipe.rolls else batch, stage, rng).mean()
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        if recipe.clip_norm:
            torch.nn.utils.clip_grad_norm_(self._model.parameters(), recipe.clip_norm)
        self._optimizer.step()
        return loss.detach()

    def _refuse_nan(self, value: float, epoch: int) -> None:
        if not math.isfinite(value):
            raise TrainingError(
                f"the loss or a weight is no longer finite in epoch {epoch + 1}: a learning rate of "
                f"{self._learning_rate_at(epoch):g} is too high for this recipe, or the images are damaged "
                f"(`symsol-annot verify` tells). {self._kept()}"
            )

    def _kept(self) -> str:
        done = self.record.epochs_done
        return f"{self._out} keeps epoch {done}" if done else "Nothing was kept, as no epoch was finished"


def new_record(recipe: Recipe, dataset: Dataset, options: Options, device: torch.device, name: str) -> TrainingRecord:
    """Return the record of a training that has no epochs yet.

    Raises:
        SettingsError: epochs, a seed or a name that no checkpoint can hold.
    """
    epochs = recipe.epochs if options.epochs is None else options.epochs
    if not 1 <= epochs <= MAX_EPOCHS:
        raise SettingsError(f"epochs: expected 1 to {MAX_EPOCHS}, found {epochs}")
    if not 0 <= options.seed <= MAX_SEED:
        raise SettingsError(f"seed: expected 0 to {MAX_SEED}, found {options.seed}")
    if name and not is_method_name(name):
        raise SettingsError(f"name: expected {METHOD_NAME_RULE}, found {name!r}")
    side = recipe.input_size or min(dataset.image_size)
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
        software=software(device, "bfloat16" if takes_bfloat16(device, recipe.precision, side) else "float32"),
    )


def _is_begun(out: Path) -> bool:
    """Tell whether a folder holds something under the name of a state: what it is, shows when it is opened."""
    return os.path.lexists(out / checkpoints.STATE_FILE)


def _first_model(record: TrainingRecord, out: Path, options: Options) -> tuple[ReferenceModel, str]:
    """Return a model with its first weights, and what its record says of where its first stage began."""
    start = record.recipe.start
    if start not in TRAINED_STARTS:
        return checkpoints.new_model(record.recipe, None if start == RANDOM else start, record.seed), start
    file = best_network(options.pretrained or trained_networks(out.resolve().parent, record), record, start)
    _, network = checkpoints.read_checkpoint_file(file)  # weights and digest are of one reading
    model = checkpoints.new_model(record.recipe, None, record.seed)
    model.first_stage.take_hypothesis_network(network.tensors, str(file))
    return model, f"{file.parent.name}, sha256 {network.sha256}"


def _validation_images(dataset: Dataset, reader: SplitReader) -> tuple[Tensor, Labels]:
    return reader.read(dataset).images, dataset.labels()


def _freeze(stage: FirstStage, *, is_frozen: bool) -> None:
    if is_frozen == next(stage.parameters()).requires_grad:
        (stage.freeze if is_frozen else stage.unfreeze)()
