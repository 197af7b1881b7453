"""Figures of a run, where matplotlib is installed and `logging` asks for them.

Who draws imports the figure's module only where one is wanted, because it needs matplotlib.
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
    """Whether there are figures; says so where they are asked for but cannot be drawn."""
    if not settings.figures:
        return False
    if importlib.util.find_spec("matplotlib") is None:
        log.info("no figure: matplotlib is not installed (pip install 'uwirl[plot]')")
        return False
    return True


def save(figure: Figure, folder: Path, name: str) -> Path:
    """figures/NAME.png below the folder of a run, whose path is returned."""
    from uwirl.study import figures

    path = folder / "figures" / f"{name}.png"
    figures.save(figure, path)
    log.info("figure: %s", path)
    return path
