"""From a log of readings to the channel behind it, and what that leaves in its run folder."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from uwirl import build
from uwirl.config.checks import ConfigError
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.runs import pictures
from uwirl.runs.interruption import Interruption
from uwirl.runs.recorded import recorded
from uwirl.snr.diagnostics import Diagnostics, diagnose
from uwirl.snr.kriging import Kriging
from uwirl.snr.log import Log, LogError, read_log
from uwirl.snr.model import UnidentifiableError, observations
from uwirl.snr.outliers import reject_outliers
from uwirl.study import estimate_report, run_folder
from uwirl.study.atomic_io import write_arrays
from uwirl.study.snr_map import Grid, SnrMap, make_grid, make_map
from uwirl.world.acoustics import LinkBudget
from uwirl.world.readings import Readings

log = logging.getLogger("uwirl")

# Lines of readings that are not believed.
LISTED = 20


@dataclass(frozen=True)
class Survey:
    """A log that can be estimated from.

    Attributes:
        config: validated.
        whole: the log.
        used: those of its readings that count.
        refused: lines of those that are not believed, [k].
        budget: what is known of links beforehand.
        sender: where the map's links begin, [3], m.
        grid: of the map.
    """

    config: EstimateConfig
    whole: Log
    used: Log
    refused: Tensor
    budget: LinkBudget
    sender: Tensor
    grid: Grid

    @classmethod
    def of(cls, config: EstimateConfig) -> Survey:
        """Read a log.

        Raises:
            LogError: it cannot be used.
            ConfigError: a setting does not suit it.
        """
        torch.set_num_threads(config.threads)
        path, budget = Path(config.data or ""), build.make_channel(config.channel).budget
        whole = read_log(path)
        used = whole.thinned(config.max_readings)
        _check_identifiable(path, used.readings, budget)
        refused = used.line[:0]
        if config.estimator.robust:
            believed = reject_outliers(used.readings, budget).snr[0][used.message, used.sensor]
            refused = used.line[believed.isnan()]
            used = replace(used, snr=believed).thinned(config.max_readings)
            _check_identifiable(path, used.readings, budget)
        from_m, z_m = config.map.from_m, config.map.z_m
        sender = whole.transmitters[-1] if from_m is None else torch.tensor(from_m, dtype=torch.float64)
        places = torch.cat([whole.transmitters, whole.receivers, sender[None]])
        try:
            z = float(whole.receivers[:, 2].mean()) if z_m is None else z_m
            grid = make_grid(places, z, config.map.spacing_m, used.heard)
        except ValueError as error:
            raise ConfigError("map.spacing_m", str(error)) from None
        return cls(config, whole, used, refused, budget, sender, grid)


def _check_identifiable(path: Path, readings: Readings, budget: LinkBudget) -> None:
    try:
        next(observations(readings, budget))
    except UnidentifiableError as error:
        raise LogError(path, str(error)) from None


def run(survey: Survey, folder: Path) -> dict[str, Any]:
    """Estimate, and write the run's folder.

    Args:
        survey: what was read.
        folder: existing, where everything is written.

    Returns:
        What metrics.json holds; how a run may end says `recorded`.
    """

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        metrics |= {"config_hash": run_folder.config_hash(survey.config), "data": survey.config.data}
        run_folder.write_config(folder, survey.config)
        metrics |= _estimate(survey, folder)

    return recorded(work, "estimate", None, folder)


@torch.no_grad()
def _estimate(survey: Survey, folder: Path) -> dict[str, Any]:
    config, whole, used = survey.config, survey.whole, survey.used
    readings = used.readings
    counts = {
        "messages": len(whole.transmitters),
        "sensors": len(whole.receivers),
        "readings": whole.heard,
        "dropouts": len(whole.snr) - whole.heard,
        "readings_refused": len(survey.refused),
        "readings_used": used.heard,
    }
    for text in _introduction(survey, counts):
        log.info("%s", text)
    # What is not believed has been left out already.
    estimator = build.make_estimator(replace(config.estimator, robust=False))
    estimate = estimator(readings, survey.budget)
    for text in estimate_report.table(estimate, used.heard):
        log.info("%s", text)

    diagnostics = diagnose(readings, estimate.channel)
    heard = ~readings.snr[0].isnan()
    line = used.table(used.line, 0)[heard]
    judged = estimate_report.diagnostic_metrics(diagnostics, line, used.names)
    for text in estimate_report.diagnosis(judged, used.heard, len(used.names)):
        log.info("%s", text)

    snr_map = make_map(Kriging(readings, estimate.channel), survey.grid, survey.sender, config.map.capacity_kbps)
    _write_arrays(folder / "estimate.npz", snr_map, diagnostics, line)
    pictures.estimate(config.logging, folder, readings, estimate, diagnostics, snr_map, used.names)
    metrics = run_folder.estimate_metrics(estimate) | counts
    metrics |= {"cost": float(estimate.cost), "evaluations": estimate.evaluations} | judged
    return metrics | {"map_from_m": survey.sender.tolist(), "map_capacity_kbps": snr_map.threshold}


def _introduction(survey: Survey, counts: dict[str, int]) -> list[str]:
    config, used = survey.config, counts["readings_used"]
    names = ("readings", "dropouts", "messages", "sensors")
    lines = [f"{config.data}: " + ", ".join(f"{counts[name]:,} {name}" for name in names)]
    if survey.whole.unused:
        lines.append(f"columns not used: {', '.join(survey.whole.unused)}")
    refused = survey.refused.tolist()
    if refused:
        which = ", ".join(map(str, refused[:LISTED])) + (", ..." if len(refused) > LISTED else "")
        lines.append(f"{len(refused):,} readings do not belong and are left out (estimator.robust), on line {which}")
    if used + len(refused) < counts["readings"]:
        lines.append(f"{used:,} readings are used, evenly over the log (max_readings={config.max_readings})")
    return lines


def _write_arrays(path: Path, snr_map: SnrMap, diagnostics: Diagnostics, line: Tensor) -> None:
    """estimate.npz: the map [Y, X] over x_m and y_m, and each reading's line and residual."""
    write_arrays(
        path,
        x_m=snr_map.grid.x.numpy(),
        y_m=snr_map.grid.y.numpy(),
        z_m=snr_map.grid.z,
        from_m=snr_map.sender.numpy(),
        snr_mean_dB=snr_map.mean.numpy(),
        snr_std_dB=snr_map.std.numpy(),
        capacity_kbps=snr_map.capacity.numpy(),
        outage=snr_map.outage.numpy(),
        line=line.numpy(),
        residual_dB=diagnostics.residual.numpy(),
        standardized=diagnostics.standardized.numpy(),
    )
