"""How far the rotations of a volume are from the nearest of some hypotheses: an integral over the volume.

Within 30 degrees of the hypotheses, where coverage is measured, the points of integration lie around each of them, in
shells between the angles at which it is measured: a ball around a hypothesis that lies in the volume and meets no other
has its exact share of SO(3), (T - sin T) / pi, however small. What is nearer to another hypothesis belongs to that, so
that balls that overlap count once. Farther away the points are the rotations of a coarse grid.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.counted import grid_inside
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import Angles, Rotations, rotations_about

Weights = npt.NDArray[np.float64]

FAR_LEVEL = 3  # of the grid of the far points; 36,864 rotations
_POINTS_PER_RAD = 300.0  # of a shell's thickness, around each hypothesis
_LEAST, _MANY = 10, 30  # points in a shell; with more hypotheses than that each has as many fewer, down to
_FEWEST = 2
_LEAST_FAR, _MOST_FAR = 1000, 5000  # points
_PAIRS_AT_ONCE = 2**21


def distances_in_volume(volume: Volume, hypotheses: Rotations, shells_rad: Angles) -> tuple[Angles, Weights]:
    """Return the distances to the nearest hypothesis at points that stand for a volume.

    Args:
        volume: what is integrated over.
        hypotheses: (M, 3, 3) R_m2c, one or more.
        shells_rad: (s,) ascending, the angles between which shells lie.

    Returns:
        (k,) angles in rad, and which share of SO(3) each point stands for, (k,); together the volume's.
    """
    near, near_weights = _near(volume, hypotheses, shells_rad)
    far = _to_nearest(_inside(volume), hypotheses)
    far = far[far > shells_rad[-1]]
    left = volume.measure - near_weights.sum()
    if not len(far) or left <= 0.0:
        return near, near_weights * (volume.measure / near_weights.sum())
    return np.concatenate([near, far]), np.concatenate([near_weights, np.full(len(far), left / len(far))])


def share_of_ball(angle_rad: Angles) -> Weights:
    """Return the share of SO(3) within an angle of a rotation, (T - sin T) / pi."""
    share: Weights = (angle_rad - np.sin(angle_rad)) / np.pi
    return share


def _near(volume: Volume, hypotheses: Rotations, shells_rad: Angles) -> tuple[Angles, Weights]:
    """Return the points within the last of the shells that are in the volume and nearest to their own hypothesis."""
    turns, angles, weights = _shells(tuple(shells_rad.tolist()), min(1.0, _MANY / len(hypotheses)))
    own_share = _own_share(hypotheses, turns) * weights
    products = hypotheses.reshape(-1, 3) @ np.moveaxis(turns, 1, 0).reshape(3, -1)  # (3 M, 3 k), faster than one by one
    points = np.swapaxes(products.reshape(len(hypotheses), 3, -1, 3), 1, 2).reshape(-1, 3, 3)
    kept = (own_share > 0.0) & volume.contains(points).reshape(own_share.shape)
    return np.broadcast_to(angles, kept.shape)[kept], own_share[kept]


def _own_share(hypotheses: Rotations, turns: Rotations) -> Weights:
    """Return 1 where the point f t (M, k) is nearest to its own hypothesis f, of n as near 1 / n, and else 0.

    In float32, so that hypotheses less than 0.00001 rad apart are as near as one another, by chance.
    """
    count = len(hypotheses)
    flat = hypotheses.astype(np.float32)
    columns = np.swapaxes(turns, 1, 2).reshape(-1, 9).T.astype(np.float32)
    shares = np.zeros((count, len(turns)))
    step = max(1, _PAIRS_AT_ONCE // (count * max(9, len(turns))))
    for start in range(0, count, step):
        own = np.arange(start, min(start + step, count))
        relative = np.swapaxes(flat, 1, 2)[:, None] @ flat[own]
        traces = (relative.reshape(-1, 9) @ columns).reshape(count, len(own), -1)  # of f_m^T f_n t
        largest = traces.max(axis=0)
        as_near = np.count_nonzero(traces == largest, axis=0)
        shares[own] = np.where(traces[own, np.arange(len(own))] == largest, 1.0 / as_near, 0.0)
    return shares


@lru_cache(maxsize=8)
def _shells(shells_rad: tuple[float, ...], density: float) -> tuple[Rotations, Angles, Weights]:
    """Return turns (k, 3, 3) by angles (k,) in shells, and the share (k,) of SO(3) that each stands for.

    The axes of a shell lie on a spiral, and the angles are even in the share of SO(3).
    """
    turns, angles, weights = [], [], []
    for inner, outer in zip((0.0, *shells_rad), shells_rad, strict=False):
        count = max(_FEWEST, round(density * max(_LEAST, _POINTS_PER_RAD * (outer - inner))))
        i = np.arange(count) + 0.5
        z, azimuth = 1.0 - 2.0 * i / count, np.pi * (1.0 + np.sqrt(5.0)) * i
        spiral = np.stack([np.sqrt(1.0 - z * z) * np.cos(azimuth), np.sqrt(1.0 - z * z) * np.sin(azimuth), z], axis=-1)
        within = (i * (np.sqrt(5.0) - 1.0) / 2.0) % 1.0
        finely = np.linspace(inner, outer, 400)
        least, most = share_of_ball(np.array([inner, outer]))
        at = np.interp(least + (most - least) * within, share_of_ball(finely), finely)
        turns.append(np.concatenate([rotations_about(axis, [turn]) for axis, turn in zip(spiral, at, strict=True)]))
        angles.append(at)
        weights.append(np.full(count, (most - least) / count))
    return np.concatenate(turns), np.concatenate(angles), np.concatenate(weights)


@lru_cache(maxsize=8)
def _inside(volume: Volume) -> npt.NDArray[np.float32]:
    """Return rotations (9, k) of the coarse grid that are inside a volume; of a small one, some drawn in it."""
    inside = grid_inside(volume, FAR_LEVEL)
    if len(inside) < _LEAST_FAR:
        R = volume.sample(_LEAST_FAR, np.random.default_rng(0))
    else:
        R = equivolumetric_grid(FAR_LEVEL)[inside[:: -(-len(inside) // _MOST_FAR)]]
    return np.ascontiguousarray(R.reshape(-1, 9).T, dtype=np.float32)


def _to_nearest(points: npt.NDArray[np.float32], hypotheses: Rotations) -> Angles:
    """Return the angles (k,) in rad from points (9, k) to the nearest hypothesis, in float32: to 0.001 rad."""
    flat, step = hypotheses.reshape(-1, 9).astype(np.float32), max(1, _PAIRS_AT_ONCE // points.shape[1])
    parts = [(flat[start : start + step] @ points).max(axis=0) for start in range(0, len(flat), step)]
    traces = np.max(parts, axis=0).astype(np.float64)
    angles: Angles = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    return angles
