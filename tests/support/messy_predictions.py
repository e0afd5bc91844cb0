"""Messy predictions, written with h5py by the format alone: hits, near misses, strays, answers at thresholds."""

from dataclasses import dataclass
from functools import lru_cache

import h5py
import numpy as np
from scipy.spatial.transform import Rotation
from scoring_oracle import ANGLES_DEG, SWEPT, angles, digest, grid, query_order

from symsol_annot.rotations.grid import GridIndex


@dataclass(frozen=True)
class Style:
    """What differs from one messy file to another."""

    level: int = 1
    real: str = "<f8"
    has_weights: bool = False
    floor: float = 0.1
    tracks: tuple[str, ...] = ("hypotheses", "classifier", "density")
    seed: int = 0


grid_of = lru_cache(grid)
index_of = lru_cache(GridIndex)


def turned(R, angle_rad, rng):
    axis = rng.normal(size=3)
    return R @ Rotation.from_rotvec(angle_rad * axis / np.linalg.norm(axis)).as_matrix()


def messy_hypotheses(truth, i, noise, rng):
    """Hits, duplicates, near misses at every threshold's scale, half turns and strays, in random order."""
    members = truth.symmetry_set(i)
    is_round = len(truth.group) >= 360 and len(members) > 1
    between = Rotation.from_euler("z", 6.1e-3 if is_round else 0.0).as_matrix()  # where no threshold is met exactly
    hit = rng.choice(members) @ between
    close = turned(hit, 10.0 ** rng.uniform(-12, -5), rng)
    misses = [turned(rng.choice(members), np.radians(rng.choice(ANGLES_DEG) * rng.uniform(0.6, 1.1)), rng)]
    misses += [turned(rng.choice(members), np.radians(rng.choice(ANGLES_DEG) * rng.uniform(0.6, 1.1)), rng)]
    misses += [*Rotation.random(2, random_state=int(rng.integers(2**32))).as_matrix()]
    misses = np.array(misses) + rng.uniform(-noise, noise, (len(misses), 3, 3))
    across = np.cross([0.0, 0.0, 1.0] if len(truth.group) >= 360 else np.ones(3), rng.normal(size=3))
    half_turn = Rotation.from_rotvec(np.pi * across / np.linalg.norm(across)).as_matrix()  # from a whole circle, too
    half_turns = [truth.rotation[i] @ half_turn]
    half_turns += [turned(truth.rotation[i], np.pi - 10.0 ** rng.uniform(-9, -2), rng)]
    return rng.permutation(np.stack([hit, hit, close, *misses, *half_turns]))


def messy_weights(count, rng):
    """Some are 0, at least one is not, and scales differ."""
    weights = rng.choice([0.0, 1e-3, 0.3, 1.0, 7.0], size=count)
    weights[rng.integers(count)] = 0.5
    return weights


def messy_probabilities(count, above, real, rng):
    """Between `above` and 1; in float64, which holds the thresholds as they are, many at exactly a threshold."""
    anywhere = above + (1.0 - above) * rng.uniform(1e-6, 1.0, count)
    exact = np.array([p for p in (0.0, *SWEPT, 1.0) if p > above]) if real == "<f8" else np.ones(1)
    return np.where(rng.random(count) < 0.4, rng.choice(exact, size=count), anywhere)


def messy_queries(truth, i, real, rng):
    """Answers that know the members, more or less, and claim some decoys; for every fifth image, nothing."""
    order = len(truth.group)
    is_member = np.concatenate([truth.mask[i], np.zeros(8 * order, dtype=bool)])
    answers = np.maximum(messy_probabilities(9 * order, -1e-9, real, rng), 0.0)
    answers = np.where(is_member | (rng.random(9 * order) < 0.3), answers, 0.0)
    return np.zeros(9 * order) if i % 5 == 0 else answers[query_order(truth.fingerprint, i, order)]


def messy_cells(truth, i, style, rng):
    """Cells near the members and others, ascending; none for every third image."""
    if i % 3 == 0:
        return np.zeros(0, dtype=int)
    if style.level < 4:
        cells = grid_of(style.level)
        near = [int(angles(member, cells).argmin()) for member in rng.choice(truth.symmetry_set(i), 3)]
    else:
        near = index_of(style.level).within(truth.symmetry_set(i), np.radians(1.0))
    return np.union1d(near, rng.integers(72 * 8**style.level, size=rng.integers(1, 40)))


def messy_density(truth, i, style, rng):
    """Cells and log-probabilities: of all cells, of none, or of some that leave a tenth or more to the others."""
    size = 72 * 8**style.level
    if i % 4 == 0:
        p = rng.dirichlet(np.full(size, 0.5)) + 1e-9
        return np.arange(size), np.log(p / p.sum())
    cells = messy_cells(truth, i, style, rng)
    p = rng.dirichlet(np.ones(len(cells))) if len(cells) else np.zeros(0)
    return cells, np.log(p * rng.uniform(0.1, 0.9) + 1e-12)


def write_messy(path, truth, style):
    """Write a predictions file by the format alone, its rows in random order."""
    rng = np.random.default_rng(style.seed)
    rows = rng.permutation(len(truth))
    columns = {"image_index": rows.astype("<i4")}
    attributes = {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": "messy",
        "object": truth.object,
        "split": truth.split,
        "fingerprint": truth.fingerprint,
        "grid_level": style.level,
        "grid_sha256": digest(grid_of(style.level)),
        "group_sha256": digest(truth.group),
        "floor": style.floor,
    }
    if "hypotheses" in style.tracks:
        noise = 2e-6 if style.real == "<f4" else 1e-7  # within what is allowed
        hypotheses = np.stack([messy_hypotheses(truth, i, noise, rng) for i in rows])
        if style.has_weights:
            weights = np.stack([messy_weights(hypotheses.shape[1], rng) for _ in rows])
            hypotheses[weights == 0] = np.nan
            columns["hypothesis_weights"] = weights.astype(style.real)
        columns["hypotheses"] = hypotheses.astype(style.real)
    if "classifier" in style.tracks:
        columns["query_probability"] = np.stack([messy_queries(truth, i, style.real, rng) for i in rows])
        cells = [messy_cells(truth, i, style, rng) for i in rows]
        claims = [messy_probabilities(len(c), style.floor, style.real, rng) for c in cells]
        columns |= sparse("grid", "probabilities", cells, claims)
    if "density" in style.tracks:
        cells, log_p = zip(*[messy_density(truth, i, style, rng) for i in rows], strict=True)
        columns |= sparse("density", "log_probabilities", cells, log_p)
    with h5py.File(path, "w") as f:
        f.attrs.update(attributes)
        for name, column in columns.items():
            f[name] = column.astype(style.real) if column.dtype == np.float64 else column
    return path


def sparse(prefix, values_name, cells, values):
    return {
        f"{prefix}_offsets": np.concatenate([[0], np.cumsum([len(c) for c in cells])]).astype("<i8"),
        f"{prefix}_indices": np.concatenate(cells).astype("<i4"),
        f"{prefix}_{values_name}": np.concatenate(values).astype(np.float64),
    }
