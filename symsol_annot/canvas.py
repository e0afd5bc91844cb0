"""matplotlib's figures: made without a display, written whole."""

import io
from pathlib import Path
from typing import Any

from symsol_annot.errors import SymsolError
from symsol_annot.files import write_atomically


def new_figure(**options: Any) -> Any:
    """Return a matplotlib Figure that needs no display.

    Raises:
        SymsolError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise SymsolError("plots need matplotlib, which is not installed: `pip install 'symsol-annot[plot]'`") from None
    figure = Figure(**options)
    FigureCanvasAgg(figure)
    return figure


def write_png(figure: Any, path: Path) -> None:
    """Write a figure as a PNG.

    Raises:
        OutputError: the file cannot be written.
    """
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=100)
    write_atomically(path, png.getvalue())
