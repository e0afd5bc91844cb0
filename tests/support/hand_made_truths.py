"""Truths made by hand, predictions about them as the readers give them, and their scores."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from messy_predictions import turned
from scoring_oracle import query_order

from symsol_annot.bench.predictions.tracks.classifier import ClassifierBlock
from symsol_annot.bench.predictions.tracks.density import DensityBlock
from symsol_annot.bench.predictions.tracks.hypotheses import HypothesesBlock
from symsol_annot.bench.predictions.tracks.on_grid import SparseRows
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.scorers.classifier import ClassifierScorer
from symsol_annot.bench.scoring.scorers.density import DensityScorer
from symsol_annot.bench.scoring.scorers.hypotheses import HypothesesScorer
from symsol_annot.rotations.groups import cyclic_group, dihedral_group, nearest_element, tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.shard.labels import Labels

ANGLE_TOLERANCE, NEAR_PI_TOLERANCE, TOLERANCE = 1e-9, 1e-7, 1e-12


quick = settings(deadline=None, max_examples=20)


GROUPS = {
    "tet": tetrahedral_group(),
    "fifths": cyclic_group(5),
    "cone": cyclic_group(360),
    "cyl": dihedral_group(360),
}
ROUND = ("cone", "cyl")
seeds = st.integers(0, 2**32 - 1)
any_group = st.sampled_from(list(GROUPS))


def hand_made(group_name, count, rng, rotation=None):
    """A truth with full sets, sets of one, arcs with single members beside them, and random sets; R_gt always in."""
    group = GROUPS[group_name]
    mask = rng.random((count, len(group))) < rng.choice([0.0, 0.5, 0.97, 1.0], size=(count, 1))
    for row in mask[::3]:
        row[rng.integers(len(row)) :] = False
    mask[:, 0] = True
    rotation = uniform_rotations(count, rng) if rotation is None else rotation
    visible = ~mask.all(axis=1)
    pixels = np.where(visible, 30.0, 0.0).astype(np.float32)
    return Truth("made", "test", "made by hand", True, 224 * 224, Labels(rotation, mask, group, pixels, visible))


def with_labels(truth, **changed):
    return replace(truth, labels=replace(truth.labels, **changed))


def scored(scorer_type, truth, block, **facts):
    scorer = scorer_type(SimpleNamespace(density_floor=None, **facts), truth)
    return scorer.score_block(block)


def score_hypotheses(truth, hypotheses, weights=None, images=None):
    images = np.arange(len(truth)) if images is None else images
    return scored(HypothesesScorer, truth, HypothesesBlock(images, hypotheses, weights), count=hypotheses.shape[1])


def some_hypotheses(truth, rng, count=5):
    """Of each image, some near its members and some anywhere; no angle is exactly a threshold."""
    made = uniform_rotations(len(truth) * count, rng).reshape(len(truth), count, 3, 3)
    for i, row in enumerate(made):
        members = truth.labels.symmetry_set(i)
        for k in range(count - 2):
            row[k] = turned(rng.choice(members), np.radians(rng.uniform(0.1, 20)), rng)
    return made


def as_sparse(rows):
    """From a list of {index: value} to sparse rows."""
    ordered = [sorted(row.items()) for row in rows]
    entries = [entry for row in ordered for entry in row]
    return SparseRows(
        np.concatenate([[0], np.cumsum([len(row) for row in ordered])]).astype(np.int64),
        np.array([n for n, _ in entries], dtype=np.int64),
        np.array([v for _, v in entries], dtype=np.float64),
    )


def assert_same_table(table, other, metrics=None):
    assert set(table.values) == set(other.values)
    for metric in metrics or table.values:
        tolerance = NEAR_PI_TOLERANCE if metric.endswith("_rad") else TOLERANCE
        np.testing.assert_allclose(table.values[metric], other.values[metric], rtol=0, atol=tolerance, err_msg=metric)
        np.testing.assert_array_equal(table.weights[metric], other.weights[metric], err_msg=metric)


def relabelled(truth, rng):
    """Name each image by another member R_gt g0 of its set; also return (N, G), where g0 g is in the group."""
    group, rotation, mask = truth.labels.symmetry_group, truth.labels.rotation.copy(), truth.labels.symmetry_mask.copy()
    moved = np.empty(mask.shape, dtype=int)
    for i in range(len(truth)):
        g0 = group[rng.choice(np.flatnonzero(mask[i]))]
        moved[i] = nearest_element(group, g0 @ group)
        rotation[i], mask[i] = rotation[i] @ g0, mask[i][moved[i]]
    return with_labels(truth, rotation=rotation, symmetry_mask=mask), moved


def some_claims(truth, rng, level=1):
    """Answers of a classifier: (N, 9, G) at candidates and decoys, not yet shuffled, and on the grid."""
    in_order = rng.choice([0.0, 0.05, 0.5, 0.8, 0.9, 1.0], size=(len(truth), 9, len(truth.labels.symmetry_group)))
    cells = [rng.choice(72 * 8**level, size=rng.integers(30), replace=False) for _ in range(len(truth))]
    return in_order, as_sparse([{int(n): rng.choice([0.3, 0.8, 0.85, 1.0]) for n in row} for row in cells])


def score_classifier(truth, in_order, on_grid, images=None, level=1, floor=0.1):
    images = np.arange(len(truth)) if images is None else images
    shuffled = [
        row.reshape(-1)[query_order(truth.fingerprint, i, row.shape[1])]
        for i, row in zip(images.tolist(), in_order, strict=True)
    ]
    block = ClassifierBlock(images, np.stack(shuffled), on_grid)
    return scored(ClassifierScorer, truth, block, grid_level=level, floor=floor)


def some_density(truth, rng, level=1):
    size = 72 * 8**level
    cells = [rng.choice(size, size=rng.integers(1, 60), replace=False) for _ in range(len(truth))]
    mass = [rng.dirichlet(np.ones(len(row))) * 0.7 for row in cells]
    return as_sparse([dict(zip(c.tolist(), np.log(p), strict=True)) for c, p in zip(cells, mass, strict=True)])


def score_density(truth, log_p, images=None, level=1):
    block = DensityBlock(np.arange(len(truth)) if images is None else images, log_p)
    return scored(DensityScorer, truth, block, grid_level=level)
