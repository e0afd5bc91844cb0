"""matplotlib's figures: made without a display, written whole."""

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from symsol_annot.errors import SettingsError
from symsol_annot.system.files import write_atomically
from symsol_annot.system.machine import check_extra

# Okabe and Ito's colours, which colour-blind people tell apart
TRUTH, PREDICTED = "#0072b2", "#d55e00"
SERIES = (TRUTH, PREDICTED, "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
PAPER_DPI = 200  # of a PNG, so that its letters are sharp on paper
_UNDRAWABLE = r"Glyph \d+ .* missing from|Matplotlib currently does not support \w+ natively"  # a box stands there
_DESCRIBED = {"png": "Description", "pdf": "Subject", "svg": "Description"}
_DATELESS: dict[str, dict[str, None]] = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}


def new_figure(**options: Any) -> Any:
    """Return a matplotlib Figure that needs no display.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    check_extra("plot", "plotting")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(**options)
    FigureCanvasAgg(figure)
    return figure


def colour_patch(colour: tuple[float, float, float], label: str) -> Any:
    """Return a rectangle of a colour (RGB from 0 to 1), as a legend has it beside a label."""
    from matplotlib.patches import Patch

    return Patch(color=colour, label=label)


def label_text(name: str) -> str:
    """Return text that matplotlib shows as it is: no `$` begins a formula, no leading `_` hides it from a legend."""
    escaped = name.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def legend_mark(label: str, color: str = "0.35", marker: str = "", line: Any = "", **style: Any) -> Any:
    """Return a mark, or a piece of line, that stands in a legend beside its label."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, marker=marker, linestyle=line, label=label_text(label), **style)


def legend_below(figure: Any, handles: Sequence[Any], columns: int = 2, title: str = "") -> None:
    """Give a figure a legend below its panels, where it hides nothing.

    Args:
        figure: with the layout "constrained".
        handles: what is named, each with its label.
        columns: how many names stand in a row at most.
        title: over the names.
    """
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=max(1, min(columns, len(handles))),
        title=title or None,
        fontsize=8,
        title_fontsize=8,
        frameon=False,
    )


def write_figure(figure: Any, path: Path, description: str = "", dots_per_inch: int = PAPER_DPI) -> None:
    """Write a figure as its path's suffix says: .png, .pdf or .svg; the same figure gives the same bytes.

    Args:
        figure: what is drawn.
        path: a PNG, PDF or SVG.
        description: what the file says of itself beside the picture.
        dots_per_inch: of a PNG, and of images inside the others.

    Raises:
        SettingsError: another suffix.
        OutputError: the file cannot be written.
    """
    form = path.suffix.lower().removeprefix(".")
    if form not in _DATELESS:
        raise SettingsError(f"{path}: expected a name that ends in .png, .pdf or .svg")
    from matplotlib import rc_context

    metadata = {**_DATELESS[form], **({_DESCRIBED[form]: description} if description else {})}
    drawn = io.BytesIO()
    with (
        rc_context({"svg.hashsalt": "symsol-annot", "pdf.fonttype": 42}),  # ids that are not drawn by lot; real fonts
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", _UNDRAWABLE)
        figure.savefig(drawn, format=form, dpi=dots_per_inch, metadata=metadata)
    write_atomically(path, drawn.getvalue())
