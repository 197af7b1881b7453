"""What a job of a multirun leaves behind when its configuration cannot run: the others go on."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import uwirl
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.overrides import effective
from uwirl.config.schema import Config
from uwirl.study import run_folder

log = logging.getLogger("uwirl")


def write_refusal(
    folder: Path, experiment: str, overrides: list[str], config: Config | EstimateConfig | None, error: BaseException
) -> dict[str, Any]:
    """What it wrote: metrics.json with status failed, and config.yaml if there is one, in a job's existing folder.

    Where an earlier run has left results, nothing is written: what stands in the way now, such as a module that is
    not found, need not for ever.
    """
    metrics: dict[str, Any] = {
        "status": "failed",
        "error": f"{type(error).__name__}: {error}",
        "experiment": experiment,
        "overrides": effective(overrides),
        "config_hash": run_folder.config_hash(config) if config else None,
        "uwirl_version": uwirl.__version__,
        "wall_time_s": 0.0,
    }
    metrics |= {key: getattr(config, key) for key in ("seed", "data") if hasattr(config, key)}
    if run_folder.has_results(folder):
        log.error("%s: keeps what an earlier run has left", folder)
        return metrics
    if config is not None:
        run_folder.write_config(folder, config)
    run_folder.write_metrics(folder, metrics)
    return metrics
