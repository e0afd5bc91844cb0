"""The benchmark: predictions in, recall, precision and F-measure out. Scoring needs neither torch nor Blender."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from symsol_annot.bench.scoring.memory.running import Metric
    from symsol_annot.bench.scoring.memory.scores import Scores

__all__ = ["Metric", "Scores"]

_HOMES = {"Metric": "symsol_annot.bench.scoring.memory.running", "Scores": "symsol_annot.bench.scoring.memory.scores"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
