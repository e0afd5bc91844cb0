"""What was given in place of a classifier's or a density's answers, and the line of code that makes such answers of it.

A line is offered only where numbers show what was meant. It may be pasted as it is: the argument has the name that the
writer gives it.
"""

from typing import Any

import numpy as np

from symsol_annot.bench.predictions.advice.remedies import said
from symsol_annot.bench.predictions.columns import Array

_SUM_TOLERANCE = 1e-3  # of a softmax in float32 over 294,912 rotations
_SURE = 0.999  # a probability of this much alone adds up to 1 without being normalised
_PEAK = 50.0  # how many times its mean a density reaches, and an energy does not
_GREATEST_LOG = 700.0  # whose exponential float64 holds


def remedy_for_probabilities(answers: Array) -> str:
    """Return what to do with a classifier's answers (n,), which are not all in [0, 1]."""
    target = "classify = lambda i, R, ask=classify: "
    if not np.isfinite(answers).all():
        return ""
    if answers.min() > -0.01 and answers.max() < 1.01:
        return said(["these are off by rounding"], f"import numpy as np; {target}np.clip(ask(i, R), 0.0, 1.0)")
    words = "these look like logits"
    if answers.max() <= 0.0:
        words += " (were they logarithms of probabilities, it would be np.exp in place of expit)"
    return said([words], f"from scipy.special import expit; {target}expit(ask(i, R))")


def remedy_for_infinity() -> str:
    """Return what to do with a log-density of infinity, as at the centre of a distribution without width."""
    line = "import numpy as np; log_density = lambda i, R, ask=log_density: np.minimum(ask(i, R), 700.0)"
    return said(["a rotation that has all of the probability may have 700, which outweighs any other"], line)


def is_normalised(answers: Array, batch_size: int) -> bool:
    """Tell whether numbers are probabilities that add up to 1 in each batch that was asked, and are not one alone."""
    if not (answers >= 0.0).all() or answers.max() > _SURE:
        return False
    return all(abs(total - 1.0) <= _SUM_TOLERANCE for total in _batch_sums(answers, batch_size))


def fault_of_log_densities(log_p: Array, batch_size: int, level: int) -> str:
    """Say what log-densities on a whole grid seem to be instead, and what to do; "" where they are.

    Args:
        log_p: (cells,), none of them NaN.
        batch_size: how many were asked about at once.
        level: of the grid.
    """
    cells = len(log_p)
    if (log_p >= 0.0).all():
        if _looks_like_density(log_p):
            line = (
                "import numpy as np; log_density = lambda i, R, ask=log_density: np.log(np.maximum(ask(i, R), 1e-300))"
            )
            return "none is negative and they add up to 1" + said(["these look like probabilities"], line)
        if cells > batch_size and all(abs(x - 1.0) <= _SUM_TOLERANCE for x in _batch_sums(log_p, batch_size)):
            code = "lambda i, R: np.log(np.maximum(log_density(i, R), 1e-300))"
            return "they add up to 1 in each batch" + _whole_grid_at_once(code, level, cells)
    elif cells > batch_size and (highest := log_p.max()) < _GREATEST_LOG:
        sums = _batch_sums(np.exp(log_p - highest), batch_size) * np.exp(highest)
        if (np.abs(sums - 1.0) <= _SUM_TOLERANCE).all():
            return "their exponentials add up to 1 in each batch" + _whole_grid_at_once("log_density", level, cells)
    return ""


def normalised_classifier(level: int, cells: int) -> str:
    """Say of a classifier's answers that are normalised over what was asked that they are a density, and what to do."""
    line = (
        "import numpy as np; from symsol_annot.bench.submission import write_density; write_density(path, dataset, "
        f"lambda i, R: np.log(np.maximum(classify(i, R), 1e-300)), method=method, level={level}, batch_size={cells})"
    )
    return (
        "the answers add up to 1 over the rotations asked about, as a softmax makes them, so none says whether a "
        "rotation is in the set"
    ) + said(["what adds up to 1 over rotations is a density"], line)


def density_of_array(given: Any, images: int, level: int, cells: int) -> str:
    """Return what to do with log-densities that are an array in place of a callable."""
    if callable(given) or np.shape(given) != (images, cells):
        return ""
    line = (
        "from symsol_annot.bench.submission import write_density; write_density(path, dataset, "
        f"lambda i, R: log_density[i], method=method, level={level}, batch_size={cells})"
    )
    return said(["this is an array with a number per cell"], line)


def _looks_like_density(values: Array) -> bool:
    """Tell whether numbers on a whole grid, none of them negative, add up to 1: as cells, or as a density on SO(3).

    Energies that begin at 0 may have any mean, so a density is told by its peak as well.
    """
    if abs(values.sum() - 1.0) <= _SUM_TOLERANCE and values.max() > values.min():
        return True
    mean = values.mean()
    is_peaked = values.max() > _PEAK * mean
    return bool(
        is_peaked and any(abs(mean * volume - 1.0) <= _SUM_TOLERANCE for volume in (1.0, np.pi**2, 8 * np.pi**2))
    )


def _batch_sums(values: Array, batch_size: int) -> Array:
    return np.add.reduceat(values, np.arange(0, len(values), batch_size), dtype=np.float64)


def _whole_grid_at_once(code: str, level: int, cells: int) -> str:
    line = (
        "import numpy as np; from symsol_annot.bench.submission import write_density; "
        f"write_density(path, dataset, {code}, method=method, level={level}, batch_size={cells})"
    )
    return said(["what is normalised has to be asked about the whole grid at once"], line)
