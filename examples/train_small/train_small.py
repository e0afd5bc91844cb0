"""Train a small network to say in which orientations an object may be, and write its predictions for scoring.

The network gives HYPOTHESES rotations per image. Its loss is the distance between two sets of rotations, both ways:
each member of the image's symmetry set wants a hypothesis near it, and each hypothesis wants a member near it.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

import symsol_annot
from symsol_annot import Dataset
from symsol_annot.bench.submission import write_hypotheses

SIZE = 32  # pixels that the network sees
HYPOTHESES = 16
MEMBERS = 32  # of a symmetry set in a step: tetX's have 3 to 9, cylO's up to 720
BATCH = 64


def main() -> None:
    """Train on the train split, predict the test split."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="a set's folder, with both splits; the sample set unless given")
    parser.add_argument("--object", default="tetX", help="of the sample set: tetX or cylO")
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--out", type=Path, default=Path("preds.h5"))
    options = parser.parse_args()
    torch.manual_seed(0)
    model = train(split_of(options, "train"), options.steps)
    test = split_of(options, "test")
    write_hypotheses(options.out, test, predict(model, test), method="train_small")
    print(f"{options.out}: {HYPOTHESES} hypotheses for each of {len(test)} images. Next:")
    print(f"  symsol-annot score {options.out} --data {test.folder}")


def split_of(options: argparse.Namespace, split: str) -> Dataset:
    """Open a split of the set that is meant."""
    if options.data:
        return symsol_annot.load(options.data, split)
    return symsol_annot.load_sample(options.object, split)


def train(dataset: Dataset, steps: int) -> nn.Module:
    """Return a network that has seen `steps` batches of a split."""
    rng = np.random.default_rng(0)
    images, sets = images_of(dataset), [sample.symmetry_set for sample in dataset]
    model = network()
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(1, steps + 1):
        rows = rng.integers(len(dataset), size=BATCH)
        members = np.stack([sets[row][rng.integers(len(sets[row]), size=MEMBERS)] for row in rows])
        loss = distance_of_sets(rotations(model(images[rows])), torch.from_numpy(members).float())
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 100 == 0:
            print(f"step {step} of {steps}: loss {loss.item():.3f}")
    return model


def predict(model: nn.Module, dataset: Dataset) -> np.ndarray:
    """Return hypotheses (N, M, 3, 3) for the images of a split."""
    model.eval()
    with torch.no_grad():
        return rotations(model(images_of(dataset)).double()).numpy()


def images_of(dataset: Dataset) -> Tensor:
    """Read the images of a split, made small: (N, 3, SIZE, SIZE) in [0, 1]."""
    small = [functional.adaptive_avg_pool2d(torch.tensor(s.image).permute(2, 0, 1) / 255, SIZE) for s in dataset]
    return torch.stack(small)


def network() -> nn.Module:
    """Return an untrained network, from images to six numbers a hypothesis."""
    layers: list[nn.Module] = []
    for inputs, outputs in ((3, 32), (32, 64), (64, 128)):
        layers += [nn.Conv2d(inputs, outputs, 3, stride=2, padding=1), nn.BatchNorm2d(outputs), nn.ReLU()]
    head = [nn.Flatten(), nn.Linear(128 * (SIZE // 8) ** 2, 256), nn.ReLU(), nn.Linear(256, HYPOTHESES * 6)]
    return nn.Sequential(*layers, *head)


def rotations(numbers: Tensor) -> Tensor:
    """Turn six numbers a hypothesis into rotations (B, M, 3, 3): two columns, made orthonormal, and their product."""
    first, second = numbers.unflatten(1, (HYPOTHESES, 2, 3)).unbind(2)
    x = functional.normalize(first, dim=-1)
    y = functional.normalize(second - (x * second).sum(-1, keepdim=True) * x, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def distance_of_sets(hypotheses: Tensor, members: Tensor) -> Tensor:
    """Return the mean distance to the nearest, from members (B, K, 3, 3) and from hypotheses (B, M, 3, 3)."""
    distance = torch.cdist(hypotheses.flatten(2), members.flatten(2))  # Frobenius norm, 2 sqrt(2) sin(angle / 2)
    return distance.amin(1).mean() + distance.amin(2).mean()


if __name__ == "__main__":
    main()
