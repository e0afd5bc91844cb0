"""Checkpoints of a tiny model, damaged: header, sizes, text, tensors."""

import copy
import json
import struct

import fuzz_predictions
import numpy as np

from attack import laws
from attack.commands import outcome_of_command
from attack.damage import damage_json, damage_text, json_bytes
from attack.kinds import Attempt, Kind

_FILES = ("weights.safetensors", "best.safetensors", "state.safetensors")
_SHARES = (0.3, 0.3, 0.3, 0.1)  # torch's own format is read by a process that imports torch


def make_checkpoints(folder):
    """Train a tiny model of each kind."""
    import torch
    from made_sets import make_set
    from tiny_training import CPU, RECIPES

    from symsol_annot.bench.models.training.loop import train
    from symsol_annot.bench.models.weights.state_dicts import read_weights
    from symsol_annot.sets.dataset import load

    data = make_set(folder / "data", "tetX", train=20, test=3, size=16, annotate="all")
    for name, recipe in RECIPES.items():
        train(recipe, load(data, "train"), folder / "runs" / name, CPU, name=name)
        torch.save(read_weights(folder / "runs" / name / _FILES[0]), folder / "runs" / name / "weights.pt")


class Checkpoints(Kind):
    """The three files of a training, and torch's own format."""

    name, cases = "checkpoints", 1000
    modules, bases = ("bench.models.inference", "bench.models.training.loop", "cli"), ("checkpoints",)

    def __init__(self, root):
        import torch
        from tiny_training import RECIPES

        torch.set_num_threads(1)
        self._folder = folder = root / "checkpoints"
        self._recipes = RECIPES
        runs = sorted((folder / "runs").iterdir())
        for run in runs:  # torch imports what it needs when it reads
            _read(run / "weights.pt")
            _open(run / _FILES[0])
        self._bases = {run.name: {path.name: path.read_bytes() for path in run.iterdir()} for run in runs}

    def attempt(self, place, number, rng):
        run = sorted(self._bases)[rng.integers(len(self._bases))]
        damaged = str(rng.choice([*_FILES, "weights.pt"], p=_SHARES))
        content, done = self._damage(self._bases[run][damaged], damaged, rng)
        if content == self._bases[run][damaged]:  # bytes may be overwritten by their like
            content, done = content[:-1] + bytes([content[-1] ^ 1]), [*done, "flipped the last bit"]
        for name, data in self._bases[run].items():
            (place.case / name).write_bytes(content if name == damaged else data)
        return Attempt([run, damaged, *done], self._action(run, damaged, place, rng))

    @staticmethod
    def _damage(content, name, rng):
        if name.endswith(".pt") or rng.random() < 0.25:
            content, damage = bytearray(content), fuzz_predictions.BYTES[rng.integers(len(fuzz_predictions.BYTES))]
            damage(content, rng)
            return bytes(content), [damage.__name__]
        length = struct.unpack_from("<Q", content)[0]
        header, data = json.loads(content[8 : 8 + length]), content[8 + length :]
        header, done = _damaged_header(header, rng)
        text = json_bytes(header)
        sizes = (0, 1, 2**31, 2**62, 2**64 - 1, len(text) + 1)
        size = len(text) if rng.random() < 0.9 else sizes[rng.integers(len(sizes))]
        return struct.pack("<Q", size) + text + data, [*done, f"header of {size}"]

    def _action(self, run, damaged, place, rng):
        kind, path = rng.random(), place.case / damaged
        if damaged == "weights.pt" or kind < 0.2:
            return lambda: _read(path)
        if damaged == "state.safetensors":
            return lambda: self._go_on(run, place.case)
        if kind < 0.8:
            return lambda: _open(path)
        data = self._folder / "data"
        return lambda: outcome_of_command("predict", path, "--data", data, "--level", 0, "--out", place.out / "p.h5")

    def _go_on(self, run, folder):
        """Go on with a training that is finished: its state is read, and nothing is trained."""
        from tiny_training import CPU

        from symsol_annot.bench.models.training.loop import train
        from symsol_annot.sets.dataset import load

        train(self._recipes[run], load(self._folder / "data" / "tetX", "train"), folder, CPU, name=run)
        return "right"


def _damaged_header(header, rng):
    kind = rng.random()
    if kind < 0.4:
        record = json.loads(header["__metadata__"]["record"])
        done = damage_json(record, rng)
        header["__metadata__"]["record"] = json_bytes(record).decode(errors="replace")
        return header, [f"record: {line}" for line in done]
    if kind < 0.6:
        header["__metadata__"]["recipe"], done = damage_text(header["__metadata__"]["recipe"], rng)
        return header, [f"recipe: {line}" for line in done]
    header = copy.deepcopy(header)
    return header, damage_json(header, rng)


def _read(path):
    from symsol_annot.bench.models.weights.state_dicts import read_weights

    weights = read_weights(path)
    if not all(isinstance(name, str) for name in weights):
        raise laws.SilentError("weights without names")
    return "right"


def _open(path):
    from symsol_annot.bench.models.training.checkpoints import open_checkpoint

    opened = open_checkpoint(path)
    record = opened.record
    words = (record.name, record.object, record.first_stage, *record.software, *record.software.values())
    if not all(word.isprintable() for word in words) or "/" in record.object:
        raise laws.SilentError(f"names that are none: {words}")
    if not all(np.isfinite(parameter.detach().numpy()).all() for parameter in opened.model.parameters()):
        raise laws.SilentError("weights that are no numbers")
    return "right"
