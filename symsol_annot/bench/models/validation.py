"""The figures of validation images: all that training takes from the scorer, by the scorer's own formulas.

No other module of the models imports `bench.scoring`: what a training tells by an epoch is then what `score` would say,
and a change of the scorer shows here. FIGURES says of each metric which way is better.
"""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.counted import counted
from symsol_annot.bench.scoring import metrics
from symsol_annot.bench.scoring.metric import HIGHER
from symsol_annot.bench.scoring.scorers.hypotheses import SLACK_RAD, errors_of_image
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.shard.labels import Labels

Figures = dict[str, float]
FIGURES = {  # whether higher is better, in the scorer's order
    metric.name: metric.better == HIGHER for scoring in SCORINGS.values() for metric in scoring.metrics if metric.better
}
_NEAR_DEG = 5


def hypothesis_figures(labels: Labels, hypotheses: Iterable[Rotations]) -> Figures:
    """Return recall and precision (section 5.2), pooled over sets and over images as `score` does.

    Args:
        labels: of a split's images.
        hypotheses: (M, 3, 3) R_m2c of each of them in turn, or of the first.

    Returns:
        Mean errors in rad, and shares within 5 degrees. A volume weighs as many members as the grid of level 4 has
        rotations inside it.
    """
    on_grid = counted(labels, STANDARD_LEVEL)
    errors = [errors_of_image(labels, on_grid, i, of_image) for i, of_image in enumerate(hypotheses)]
    of_set, of_hypotheses = (np.concatenate(parts) for parts in zip(*(e[:2] for e in errors), strict=True))
    measures = [np.ones(len(e.of_set)) if e.measures is None else e.measures for e in errors]
    each = zip(measures, on_grid.set_sizes, strict=False)
    weights = np.concatenate([m * (size / m.sum()) for m, size in each]) if labels.volumes else None
    near = np.radians([_NEAR_DEG]) + SLACK_RAD
    return {
        "recall_mean_error_rad": metrics.mean_error(of_set, weights),
        "precision_mean_error_rad": metrics.mean_error(of_hypotheses),
        f"coverage_at_{_NEAR_DEG}_deg": float(metrics.share_within(of_set, near, weights)[0]),
        f"accuracy_at_{_NEAR_DEG}_deg": float(metrics.share_within(of_hypotheses, near)[0]),
    }


def classifier_figures(counts: Iterable[tuple[int, int, int]]) -> Figures:
    """Return the means over images of recall, precision and F-measure (section 7.2).

    Args:
        counts: per image its true positives, its false positives, and how many members its symmetry set has.
    """
    rows = []
    for true, false, set_size in counts:
        true_positives, false_positives = _one(true), _one(false)
        rows.append(
            (
                metrics.recall(true_positives, set_size),
                metrics.precision(true_positives, false_positives),
                metrics.f_measure(true_positives, false_positives, set_size),
            )
        )
    means = np.mean(rows, axis=0).ravel().tolist()
    return dict(zip(("recall", "precision", "f_measure"), means, strict=True))


def _one(count: int) -> npt.NDArray[np.int64]:
    return np.array([count], dtype=np.int64)
