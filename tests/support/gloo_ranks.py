"""A rank of two: scores its share of a split in batches, gathers the others' states, and prints the figures."""

import sys

import numpy as np
import torch.distributed as dist

import symsol_annot
from symsol_annot.bench import Metric


def log_density(i, R):
    return 3.0 * R[:, 1, 1] * np.cos(i)


def main(rank, ranks, rendezvous, folder, hypotheses):
    dist.init_process_group("gloo", init_method=f"file://{rendezvous}", rank=rank, world_size=ranks)
    test, predicted = symsol_annot.load(folder), np.load(hypotheses)
    of_rotations, of_density = Metric(test), Metric(test, "density", level=0)
    mine = [*range(rank, len(test), ranks), 0]  # as a sampler that fills up: image 0 is everybody's
    for start in range(0, len(mine), 4):
        index = mine[start : start + 4]
        of_rotations.update(predicted[index], index)
        of_density.update(log_density, index)
    for metric in (of_rotations, of_density):
        states = [None] * ranks
        dist.all_gather_object(states, metric.state())
        metric.merge(*states)
        print(repr(metric.compute().figures))
    dist.destroy_process_group()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
