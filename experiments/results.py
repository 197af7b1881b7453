"""What a script of this folder leaves in its run folder."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig

from uwirl.study import run_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger("uwirl")


def leave(metrics: Mapping[str, Any], figure: Figure | None = None) -> None:
    """Write metrics.json, and a figure under the experiment's name; only the latter needs matplotlib."""
    hydra = HydraConfig.get()
    name, folder = hydra.job.name, Path(hydra.runtime.output_dir)
    run_folder.write_metrics(folder, {"status": "complete", "experiment": name, **metrics})
    if figure is not None:
        from uwirl.study import figures

        figures.save(figure, folder / "figures" / f"{name}.png")
    log.info("everything lies in %s", folder)


def tell(metrics: Mapping[str, Any], form: str = "") -> None:
    """Log a number a line, formatted as `form` says."""
    width = max(map(len, metrics))
    for name, value in metrics.items():
        log.info("%-*s %s", width, name, format(value, form))
