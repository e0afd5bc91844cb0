"""Truths whose sets have a volume, and their figures once more: in plain loops, and from the volume's equation.

The volume is all R that see the object from within an angle of its z axis: a cap of directions v, whose share of SO(3)
is (1 - cos a) / 2, and from which R is max(0, angle(v, z) - a) away. No code is shared with the package but what makes
the truths; grid and queries are `scoring_oracle`'s.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation
from scoring_oracle import ANGLES_DEG, angles, mean, query_order
from scoring_oracle import grid as plain_grid
from scoring_oracle import queries as plain_queries

from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.sets.shard.labels import Labels

RINGS = 44  # of the grid of level 5 around its pole, which make up the cap exactly
_DIRECTIONS = [4 * min(ring + 1, 127 - ring, 32) for ring in range(127)]
COSINE = 1.0 - 2.0 * sum(_DIRECTIONS[:RINGS]) / 12288
SHARE = (1.0 - COSINE) / 2.0
CANDIDATES = np.concatenate(
    [np.eye(3)[None], Rotation.from_rotvec(np.radians([[90, 0, 0], [180, 0, 0], [270, 0, 0], [0, 40, 0]])).as_matrix()]
)
PLAIN_GRID = {level: plain_grid(level) for level in (0, 1)}


def cap():
    return Volume.of_directions(lambda v: v[:, 2] >= COSINE)


def to_cap(R):
    """The angles from rotations (n, 3, 3) to the cap."""
    return np.maximum(0.0, np.arccos(np.clip(-R[:, 2, 2], -1, 1)) - math.acos(COSINE))


def made_truth(count, rng, volume=None):
    """Two images out of three see the object from within the cap; of the others some have several members."""
    volume = cap() if volume is None else volume
    rotation = Rotation.random(count, random_state=int(rng.integers(2**31))).as_matrix()
    with_volume = np.arange(count) % 3 > 0
    inside = volume.sample(count, rng)
    rotation[with_volume] = inside[with_volume]
    mask = rng.random((count, len(CANDIDATES))) < 0.5
    mask[with_volume] = False
    mask[:, 0] = True
    labels = Labels(
        rotation,
        mask,
        CANDIDATES,
        np.zeros(count, np.float32),
        np.zeros(count, bool),
        None,
        np.where(with_volume, 0, -1).astype(np.int32),
        (volume,),
    )
    return Truth("marked-ball", "test", "made by hand", False, 224 * 224, labels)


def members_of(truth, i):
    return np.array([truth.labels.rotation[i] @ g for g in CANDIDATES[truth.labels.symmetry_mask[i]]])


def is_filled(truth, i):
    return truth.labels.volume[i] >= 0


def to_set(truth, i, R):
    """The angles from rotations (n, 3, 3) to the set of image i."""
    to_members = np.min([angles(member, R) for member in members_of(truth, i)], axis=0)
    return np.minimum(to_members, to_cap(R)) if is_filled(truth, i) else to_members


def counted(truth, i, level):
    """Of the members those that count, as flags, and the indices of the grid's rotations that do."""
    members, grid = members_of(truth, i), PLAIN_GRID[level]
    if not is_filled(truth, i):
        return [True] * len(members), []
    inside = [n for n in range(len(grid)) if -grid[n, 2, 2] >= COSINE]
    return [int(angles(member, grid).argmin()) not in inside for member in members], inside


def classifier_figures(truth, i, in_order, on_grid, level):
    """Of answers (9, G) at candidates and decoys, and {index: value} on the grid."""
    grid, threshold = PLAIN_GRID[level], 0.8
    flags, inside = counted(truth, i, level)
    places = np.flatnonzero(truth.labels.symmetry_mask[i])
    asked = [place for place, counts in zip(places, flags, strict=True) if counts]
    tp = sum(in_order[0, g] > threshold for g in asked) + sum(on_grid.get(n, 0) > threshold for n in inside)
    claimed = [n for n, p in on_grid.items() if p > threshold and n not in inside]
    fp, size, negatives = len(claimed), len(asked) + len(inside), len(grid) - len(inside)
    far = sum(to_set(truth, i, grid[n][None])[0] > math.radians(0.5) for n in claimed)
    asked_in_order = np.empty((9 * len(CANDIDATES), 3, 3))
    asked_in_order[query_order(truth.fingerprint, i, len(CANDIDATES))] = plain_queries(
        truth.fingerprint, i, truth.labels.rotation[i], CANDIDATES
    )
    decoys = asked_in_order[len(CANDIDATES) :]
    outside = [n for n, R in enumerate(decoys) if not (is_filled(truth, i) and -R[2, 2] >= COSINE)]
    rejected = [
        g
        for g in range(len(CANDIDATES))
        if to_set(truth, i, (truth.labels.rotation[i] @ CANDIDATES[g])[None])[0] > math.radians(5) + 1e-9
    ]
    return {
        "recall": tp / size,
        "precision": tp / (tp + fp) if tp + fp else 1.0,
        "f_measure": 2 * tp / (tp + fp + size),
        "accuracy": (tp + negatives - fp) / (size + negatives),
        "precision_beyond_half_degree": tp / (tp + far) if tp + far else 1.0,
        "grid_positive_rate": fp / negatives if negatives else math.nan,
        "decoy_false_positive_rate": mean([in_order[1:].ravel()[n] > threshold for n in outside]),
        "hard_negative_rate": mean([in_order[0, g] > threshold for g in rejected]) if rejected else math.nan,
    }


def density_figures(truth, i, listed, level):
    """Of {index: log-probability}; what is left is shared by the other cells."""
    grid = PLAIN_GRID[level]
    flags, inside = counted(truth, i, level)
    members = [m for m, counts in zip(members_of(truth, i), flags, strict=True) if counts]
    cells = [int(angles(m, grid).argmin()) for m in members] + inside
    rest = (1 - math.fsum(math.exp(v) for v in listed.values())) / (len(grid) - len(listed))
    log_p = [listed.get(n, math.log(rest)) for n in range(len(grid))]
    best = {cell: cells.count(cell) / len(cells) for cell in cells}
    distances, per_volume = to_set(truth, i, grid), math.log(len(grid) / math.pi**2)
    at_gt = int(angles(truth.labels.rotation[i], grid).argmin())
    return {
        "log_likelihood": mean([log_p[cell] for cell in cells]) + per_volume,
        "log_likelihood_ceiling": mean([math.log(best[cell]) for cell in cells]) + per_volume,
        "log_likelihood_at_gt": log_p[at_gt] + per_volume,
        "log_likelihood_at_gt_ceiling": math.log(best[at_gt]) + per_volume,
        "spread_rad": math.fsum(math.exp(p) * d for p, d in zip(log_p, distances, strict=True)),
        "spread_at_ceiling_rad": math.fsum(share * distances[cell] for cell, share in best.items()),
    }


def hypotheses_figures(truth, i, hypotheses, rng, draws=50_000):
    """By Monte Carlo: rotations drawn in the cap, beside which a member weighs next to nothing."""
    assert is_filled(truth, i)
    tilt, azimuth = rng.uniform(0, 2 * np.pi, (2, draws))
    polar = np.arccos(-rng.uniform(COSINE, 1.0, draws))
    drawn = Rotation.from_euler("ZYZ", np.stack([azimuth, polar, tilt], axis=-1)).as_quat()
    asked = Rotation.from_matrix(hypotheses).as_quat()
    nearest = 2 * np.arccos(np.clip(np.abs(drawn @ asked.T).max(axis=1), 0, 1))
    of_hypotheses = to_set(truth, i, hypotheses)
    figures = {"recall_mean_error_rad": nearest.mean(), "precision_mean_error_rad": of_hypotheses.mean()}
    for degrees in ANGLES_DEG:
        coverage, accuracy = ((e <= np.radians(degrees) + 1e-6).mean() for e in (nearest, of_hypotheses))
        figures[f"coverage_at_{degrees}_deg"] = coverage
        figures[f"accuracy_at_{degrees}_deg"] = accuracy
    return figures
