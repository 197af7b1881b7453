"""What a script of this folder leaves in its run folder."""

from __future__ import annotations

import logging
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from uwirl.study import run_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

log = logging.getLogger("uwirl")

# What --help begins with: the script's own docstring.
OmegaConf.register_new_resolver("about", lambda: (sys.modules["__main__"].__doc__ or "").strip(), replace=True)


def leave(metrics: Mapping[str, Any], figure: Figure | None = None) -> None:
    """Write metrics.json, and a figure under the experiment's name; only the latter needs matplotlib."""
    hydra = HydraConfig.get()
    name, folder = hydra.job.name, Path(hydra.runtime.output_dir)
    run_folder.write_metrics(folder, {"status": "complete", "experiment": name, **metrics})
    if figure is not None:
        from uwirl.study import style

        style.save(figure, folder / "figures" / f"{name}.png")
    log.info("everything lies in %s", folder)


def tell(metrics: Mapping[str, Any], form: str = "") -> None:
    """Log a number a line, formatted as `form` says."""
    width = max(map(len, metrics))
    for name, value in metrics.items():
        log.info("%-*s %s", width, name, format(value, form))
