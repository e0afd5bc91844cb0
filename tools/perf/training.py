"""How fast a model is trained, beside the network alone: forward, backward and step on random tensors.

python tools/perf/training.py FOLDER [RECIPE ..] [--device auto] [--rounds 5] [--seconds 8] [--json FILE]

FOLDER is a set with a train split. The ways take turns within a round, each on a warm network of its own; a share is
taken within its round, and medians are told. Neither counts the evaluation of validation images, nor the writing of
checkpoints, of which there is one an epoch: both are timed apart. On a CPU shares are of the process's own time, which
other processes change less; OMP_NUM_THREADS=1 keeps its threads from waiting for each other, where others are at work.
"""

import argparse
import itertools
import json
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from sets import peak_mib

from symsol_annot.bench.models.batches import Batch
from symsol_annot.bench.models.devices import choose_device, laid_out_for
from symsol_annot.bench.models.kinds import kind_of
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.training import checkpoints, loop
from symsol_annot.sets.dataset import load


def measure(folder, recipe="small-wta", device="auto", rounds=5, seconds=8.0):
    """Time training and the bare network.

    Returns:
        images_per_second of both, the medians; share, the median over rounds; where the images were; once_s, what
        reading the images took, and an epoch's evaluation and its checkpoint; peak memory in MiB.
    """
    device = choose_device(device)
    with load(folder, "train") as images, tempfile.TemporaryDirectory() as temporary:
        made = load_recipe(recipe).for_object(images.object, has_marking=images.has_marking)
        made = replace(made, start="random", validation_images=min(made.validation_images, len(images) // 4))
        options = loop.Options(device=str(device))
        record = loop.new_record(made, images, options, device, recipe)
        start = time.perf_counter()
        run = loop.TrainingLoop(record, images, Path(temporary), options, device)
        once = {"read_s": time.perf_counter() - start}
        ways: dict[str, Any] = {"training": _Training(run, device), "network alone": _Bare(made, images, device)}
        for way in ways.values():
            way.rate(min(2.0, seconds))
        found = {name: [] for name in ways}
        for number in range(rounds):
            for name in list(ways)[:: 1 if number % 2 else -1]:
                found[name].append(ways[name].rate(seconds))
        once |= _once_an_epoch(run, Path(temporary))
        where = run._source.where
    clock = 0 if device.type == "cuda" else 1
    shares = [mine[clock] / bare[clock] for mine, bare in zip(found["training"], found["network alone"], strict=True)]
    return {
        "device": torch.cuda.get_device_name(device)
        if device.type == "cuda"
        else f"cpu, {torch.get_num_threads()} threads",
        "backbone": record.software["precision"],
        "images_in": where,
        "images_per_second": {
            name: round(statistics.median(wall for wall, _ in rates), 1) for name, rates in found.items()
        },
        "share": round(statistics.median(shares), 3),
        "shares": [round(share, 3) for share in shares],
        "once_s": {name: round(value, 2) for name, value in once.items()},
        "peak_mib": peak_mib(),
        "peak_gpu_mib": round(torch.cuda.max_memory_allocated(device) / 2**20) if device.type == "cuda" else None,
    }


class _Training:
    """The steps of a training: batches from its data, losses checked as it checks them."""

    def __init__(self, run, device):
        self._run, self._device = run, device
        self._batches = itertools.chain.from_iterable(run._source.batches(epoch) for epoch in itertools.count())
        self._rng = torch.Generator(device).manual_seed(0)

    def rate(self, seconds):
        self._run._model.train()
        return _rate(self._step, seconds, self._device)

    def _step(self, number):
        batch = next(self._batches)
        loss = self._run._step_or_say_what_fits(batch, self._run.record.epochs / 2, self._rng)
        if number % loop._STEPS_BETWEEN_CHECKS == 0:
            self._run._refuse_nan(float(loss), 0)
        return len(batch.images)


class _Bare:
    """The same network, losses and optimiser on one random batch that is there already."""

    def __init__(self, recipe, images, device):
        width, height = (recipe.input_size, recipe.input_size) if recipe.input_size else images.image_size
        model = laid_out_for(device, checkpoints.new_model(recipe, None, 0))
        self._learner = kind_of(recipe).method.learner(recipe, model, images.symmetry_group)
        self._optimizer = torch.optim.Adam(model.parameters(), lr=recipe.learning_rates[0], fused=True)
        self._rng, self._device = torch.Generator(device).manual_seed(0), device
        self._epoch = recipe.epochs / 2
        shape = (recipe.batch_size, height, width, 3)
        pixels = torch.randint(0, 256, shape, dtype=torch.uint8, device=device)
        R_gt = torch.eye(3, device=device).expand(recipe.batch_size, 3, 3)
        is_member = torch.ones((recipe.batch_size, len(images.symmetry_group)), dtype=torch.bool, device=device)
        self._batch = Batch(pixels, R_gt, is_member=is_member if recipe.needs_members else None)

    def rate(self, seconds):
        self._learner.model.train()
        return _rate(self._step, seconds, self._device)

    def _step(self, _):
        loss = self._learner.losses(self._batch, self._epoch, self._rng).mean()
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._optimizer.step()
        return len(self._batch.images)


def _rate(step, seconds, device):
    """Return images per second of steps that go on for so long, and images per second of this process's own time."""
    _wait(device)
    start, own_start, images = time.perf_counter(), time.process_time(), 0
    for number in itertools.count():
        images += step(number)
        if number % 20 == 19:
            _wait(device)
        if time.perf_counter() - start > seconds:
            break
    _wait(device)
    return images / (time.perf_counter() - start), images / (time.process_time() - own_start)


def _wait(device):
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _once_an_epoch(run, folder):
    start = time.perf_counter()
    run._learner.evaluate(*run._validation_images)
    evaluated = time.perf_counter()
    run.record = replace(run.record, rows=({"epoch": 1.0, "loss": 1.0, "learning_rate": 1.0},))
    checkpoints.save(folder, run.record, run._model, run._optimizer)
    run._publish()
    return {"evaluate_s": evaluated - start, "checkpoint_s": time.perf_counter() - evaluated}


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("recipes", nargs="*", default=["small-wta", "small-classifier"])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = {}
    for recipe in arguments.recipes:
        found[recipe] = measure(arguments.folder, recipe, arguments.device, arguments.rounds, arguments.seconds)
        print(recipe)
        for name, value in found[recipe].items():
            print(f"  {name:<18} {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
