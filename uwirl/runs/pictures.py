"""Figures of a run, if matplotlib is installed and `logging` asks for them.

Modules that draw need matplotlib, so they are imported only if a figure is wanted.
"""

from __future__ import annotations

import importlib.util
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from uwirl.config.schema import LoggingConfig

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger("uwirl")


def wanted(settings: LoggingConfig) -> bool:
    """Whether to draw figures; logs a message if they are asked for but matplotlib is missing."""
    if not settings.figures:
        return False
    if importlib.util.find_spec("matplotlib") is None:
        log.info("no figure: matplotlib is not installed (pip install 'uwirl[plot]')")
        return False
    return True


def save(figure: Figure, folder: Path, name: str) -> Path:
    """Save figures/NAME.png, and a PDF beside it, in the folder of a run; returns the path of the former."""
    from uwirl.study import style

    path = folder / "figures" / f"{name}.png"
    style.save(figure, path)
    log.info("figure: %s", path)
    return path
