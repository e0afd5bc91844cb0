"""How fast the trainings of docs/effects.py are beside their base, and how fast a grid is scored without its means.

python tools/perf/effect_speeds.py SET [--rounds 5] [--seconds 4] [--images 4000] [--json FILE]

With --json docs/results/effect_speeds.json the table of docs/training.md has them, once docs/effects.py writes it.

All ways take turns within a round, each on a network of its own that is warm, and each round's rates are divided by the
base's of that round; medians are told, of the process's own time, which other processes change less.
OMP_NUM_THREADS=1 keeps its threads from waiting for each other.
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

import torch
from training import _Training

from symsol_annot.bench.models.devices import choose_device, hardware
from symsol_annot.bench.models.networks.answers import RotationScorer
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.bench.models.recipe import recipe_from_toml
from symsol_annot.bench.models.training import loop
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.sets.dataset import load
from symsol_annot.system.files import write_atomically

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))
from effects import BASES, EFFECTS, recipe_text

SAME_SPEED = ("schedule", "warm_up", "bias_from_negatives", "fitted_shift")  # keys that change no step's work


def main():
    """Measure, and print or write what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--images", type=int, default=4000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {
        "machine": f"{hardware(choose_device('cpu'))}",
        "training": of_training(options.set, options.rounds, options.seconds, options.images),
        "grid": of_grid(options.rounds),
    }
    text = json.dumps(found, indent=1) + "\n"
    print(text, end="")
    if options.json:
        write_atomically(options.json, text.encode())


def of_training(folder, rounds, seconds, images):
    """Return, by name, images per second of a base, and the speed of what is changed beside its base."""
    names = [name for name in EFFECTS if name in BASES or not set(EFFECTS[name]) <= set(SAME_SPEED)]
    with load(folder, "train") as every, tempfile.TemporaryDirectory() as temporary:
        ways = {name: _way(name, every[:images], Path(temporary) / name) for name in names}
        rates = _in_turn({name: lambda way=way: way.rate(seconds)[1] for name, way in ways.items()}, rounds)
    return {name: _beside(rates[name.partition(",")[0]], rates[name], is_base=name in BASES) for name in names}


def of_grid(rounds):
    """Return how fast a classifier scores the grid of level 4 without one of the means, beside with all of them."""
    model = RotationClassifier(3, pretrained=None, rng=torch.Generator().manual_seed(0), input_size=32).eval()
    embedding = torch.rand(256, generator=torch.Generator().manual_seed(1))
    R = torch.from_numpy(equivolumetric_grid(4)).float()
    scorer = RotationScorer(model)
    with torch.no_grad():
        shares = torch.cat([model.shares(part) for part in torch.split(R, 2**15)])
        ways = {
            "nothing": lambda: scorer.logits(embedding, shares),
            "the grid is encoded anew for each image": lambda: scorer.logits(
                embedding, torch.cat([model.shares(part) for part in torch.split(R, 2**15)])
            ),
            "all rotations in one block": lambda: model.second_stage.from_shares(
                model.second_stage.share_of_embeddings(embedding[None])[0], shares
            ),
        }
        rates = _in_turn({name: lambda way=way: _images_per_second(way) for name, way in ways.items()}, rounds)
    return {name: _beside(rates["nothing"], rates[name], is_base=name == "nothing") for name in ways}


def _way(name, images, folder):
    recipe = recipe_from_toml(recipe_text(name), name)
    device = choose_device("cpu")
    options = loop.Options(device="cpu")
    return _Training(
        loop.TrainingLoop(loop.new_record(recipe, images, options, device, ""), images, folder, options, device), device
    )


def _in_turn(ways, rounds):
    """Return the rates (rounds,) of each way, after one that does not count."""
    found = {name: [] for name in ways}
    for number in range(rounds + 1):
        for name in list(ways)[:: 1 if number % 2 else -1]:
            found[name].append(ways[name]())
    return {name: rates[1:] for name, rates in found.items()}


def _images_per_second(way):
    start = time.process_time()
    way()
    return 1.0 / (time.process_time() - start)


def _beside(base, rates, *, is_base):
    shares = [rate / of_base for rate, of_base in zip(rates, base, strict=True)]
    return (
        {"per_second": round(statistics.median(rates), 2)}
        if is_base
        else {"speed": round(statistics.median(shares), 3), "speeds": [round(share, 3) for share in shares]}
    )


if __name__ == "__main__":
    main()
