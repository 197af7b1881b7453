"""Runs of `uwirl-estimate`: a log is estimated and the result written to a run folder."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

import uwirl
from uwirl import build
from uwirl.config.checks import ConfigError
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.runs import pictures
from uwirl.runs.interruption import Interruption
from uwirl.runs.recorded import recorded, warn
from uwirl.study import checkpoint, estimate_report, run_files, run_folder
from uwirl.study.learning_file import estimate_of
from uwirl.study.progress import bar
from uwirl.study.snr_map import Grid
from uwirl.study.survey import Survey

log = logging.getLogger("uwirl")


class Prepared(NamedTuple):
    """Validated settings, the log read with them, the grid of the map, and the position of its sender, [3], m."""

    config: EstimateConfig
    survey: Survey
    grid: Grid
    sender: Tensor


def prepare(config: EstimateConfig) -> Prepared:
    """Read a log.

    Raises:
        LogError: it cannot be used.
        ConfigError: a setting does not suit it.
    """
    torch.set_num_threads(config.threads)
    budget = build.make_channel(config.channel).budget
    survey = Survey.read(config.data or "", budget, config.max_readings, config.estimator.robust)
    try:
        return Prepared(config, survey, *survey.frame(config.map.from_m, config.map.z_m, config.map.spacing_m))
    except ValueError as error:
        raise ConfigError("map.spacing_m", str(error)) from None


def run(prepared: Prepared, folder: Path) -> dict[str, Any]:
    """Estimate, and write the run's folder.

    Args:
        prepared: settings and log.
        folder: an existing folder for everything that is written.

    Returns:
        Content of metrics.json, see `uwirl.runs.recorded`.
    """

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        metrics |= {"config_hash": run_folder.config_hash(prepared.config), "data": prepared.config.data}
        run_folder.write_config(folder, prepared.config)
        metrics |= _estimate(*prepared, folder)

    return recorded(work, "estimate", None, folder)


@torch.no_grad()
def _estimate(config: EstimateConfig, survey: Survey, grid: Grid, sender: Tensor, folder: Path) -> dict[str, Any]:
    used = survey.used
    _tell(estimate_report.introduction(survey, config.data or ""))
    # Estimate, what is possible, what the others predict, map: a second together, or half a minute of 1,500 readings.
    with bar("estimating", 4, config.logging.progress) as progress:
        # Outliers have been removed already.
        estimate = survey.estimate(build.make_estimator(replace(config.estimator, robust=False)))
        progress.update()
        _tell(estimate_report.table(estimate, survey.posterior, used.heard))
        doubts = survey.doubts(estimate)
        _doubt(doubts)
        progress.update()
        diagnostics = survey.diagnose()
        progress.update()
        judged = estimate_report.diagnostic_metrics(diagnostics, survey.line, used.names)
        _tell(estimate_report.diagnosis(judged, used.heard))
        suspicions = list(estimate_report.suspicions(judged, used.heard))
        _doubt(suspicions)
        if not doubts + suspicions:
            few = used.heard < estimate_report.LEAST
            _tell(["too few readings to tell what is wrong" if few else "nothing looks wrong"])
        snr_map = survey.map(grid, sender, config.map.capacity_kbps)
        progress.update()
    run_files.write_estimate(folder, snr_map, diagnostics, survey.line)
    content = {
        "uwirl_version": uwirl.__version__,
        "config": asdict(config),
        "config_hash": run_folder.config_hash(config),
    }
    checkpoint.save(folder / "checkpoints" / "estimate.pt", content | estimate_of(estimate))
    if pictures.wanted(config.logging):
        from uwirl.study.estimate_figure import estimate_figure

        pictures.save(estimate_figure(used.readings, estimate, diagnostics, snr_map, used.names), folder, "estimate")
    metrics = run_files.estimate_metrics(estimate) | estimate_report.open_metrics(survey.posterior) | survey.counts
    metrics |= {"cost": float(estimate.cost), "evaluations": estimate.evaluations} | judged
    return metrics | {"map_from_m": sender.tolist(), "map_capacity_kbps": snr_map.threshold}


def _doubt(sentences: Iterable[str]) -> None:
    for sentence in sentences:
        warn(sentence)


def _tell(lines: Iterable[str]) -> None:
    for line in lines:
        log.info("%s", line)
