"""One look for all figures: a paper's size, one size of type; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import io
import logging
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uwirl.study.atomic_io import write_whole
from uwirl.study.colours import DISTINCT

# Widths of one and of two columns of a journal, inches.
COLUMN, PAGE = 3.5, 7.16
DPI = 200

# It reports each font that it writes to a PDF.
logging.getLogger("fontTools").setLevel(logging.ERROR)

# Used as a decorator of what draws. Figures are saved under it too, because tick labels are created only then.
paper = matplotlib.rc_context(
    {
        "font.size": 8,
        "axes.titlesize": 8,
        "axes.titlelocation": "left",
        "axes.titlepad": 4.0,
        "axes.labelsize": 8,
        "xtick.labelsize": 7,
        "ytick.labelsize": 7,
        "legend.fontsize": 7,
        "legend.handlelength": 1.5,
        "legend.framealpha": 0.9,
        "figure.titlesize": 8,
        "axes.prop_cycle": cycler(color=DISTINCT),
        "axes.linewidth": 0.6,
        "axes.axisbelow": True,
        "xtick.major.width": 0.6,
        "ytick.major.width": 0.6,
        "grid.alpha": 0.3,
        "grid.linewidth": 0.5,
        "lines.linewidth": 1.1,
        "lines.markersize": 4.0,
        "patch.linewidth": 0.6,
        "boxplot.boxprops.linewidth": 0.7,
        "boxplot.whiskerprops.linewidth": 0.7,
        "boxplot.capprops.linewidth": 0.7,
        # Text stays text.
        "pdf.fonttype": 42,
    }
)


def new(width: float, height: float) -> Figure:
    """An empty figure of a size in inches, whose panels find their places by themselves."""
    return Figure(figsize=(width, height), layout="constrained")


@paper
def save(figure: Figure, path: Path) -> None:
    """Write a PNG file and beside it a PDF of the same name; their folder is created if missing.

    Args:
        figure: a figure of this module's look.
        path: path of the PNG file.

    Raises:
        OSError: writing failed; each file is then complete or as it was before.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for target, form in ((path, "png"), (path.with_suffix(".pdf"), "pdf")):
        buffer = io.BytesIO()
        figure.savefig(buffer, dpi=DPI, format=form)
        # The panels have found their places: the second drawing would find the same.
        figure.set_layout_engine("none")
        write_whole(target, buffer.getvalue())


def letter(panels: list[Axes]) -> None:
    """Put (a), (b), ... before the titles of panels."""
    for k, axes in enumerate(panels):
        axes.set_title(f"({chr(ord('a') + k)}) {axes.get_title(loc='left')}", loc="left")
