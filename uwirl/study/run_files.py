"""What a run writes into its folder beside settings and metrics: arrays, and tables."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import fields
from itertools import zip_longest
from pathlib import Path
from typing import Any

from torch import Tensor

from uwirl.motion.identification import Identified
from uwirl.motion.learning import IterationRecord, LearningState
from uwirl.snr.diagnostics import Diagnostics
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.study.atomic_io import read_whole, write_arrays, write_whole
from uwirl.study.campaign import Outcomes
from uwirl.study.evaluation import Evaluation
from uwirl.study.shadowing import LinksAtMessages
from uwirl.study.snr_map import SnrMap
from uwirl.world.layouts import Layouts

# Largest size of iterations.csv, which has 100 bytes for each of some hundred iterations.
MOST_BYTES = 10**8
# Columns of iterations.csv.
ITERATION_COLUMNS = (
    "iteration",
    "vehicle_seconds",
    "rows",
    "weight_change",
    "bellman_residual",
    "condition_number",
    "cost_total",
    "converged",
)


def estimate_metrics(estimate: ChannelEstimate) -> dict[str, Any]:
    """Parameters of an estimate as entries of metrics.json: a number, or a list with one for each data set."""
    metrics: dict[str, Any] = {}
    for name in NAMES:
        parameter = estimate.parameter(name)
        known = parameter.identifiable.tolist()
        # Unidentifiable values become null.
        values, stds = ([x if t else None for x, t in zip(xs.tolist(), known, strict=True)] for xs in parameter[:2])
        for key, row in (("", values), ("_std", stds), ("_identifiable", known)):
            metrics[f"estimate_{name}{key}"] = row[0] if len(row) == 1 else row
    return metrics


def learning_metrics(state: LearningState, dt: float) -> dict[str, Any]:
    """Entries of metrics.json about how it was learned, in steps of dt, s."""
    return {
        "learning_vehicle_seconds": state.seconds,
        "learning_env_steps": round(state.seconds / dt),
        "learning_collisions": state.contacts,
        "policy_iterations": state.learner.iteration,
    }


def model_metrics(names: tuple[str, ...], known: Identified | None) -> dict[str, Any]:
    """Entries of metrics.json about a model learned in flight: its parameters and their standard errors."""
    metrics: dict[str, Any] = {}
    for name, value, std in () if known is None else known.items(names):
        metrics |= {f"model_{name}": value, f"model_{name}_std": std}
    return metrics


def write_trajectory(folder: Path, evaluation: Evaluation, messages: LinksAtMessages) -> None:
    """Write trajectory.npz, with the mission of the first world.

    time_s [n + 1], eta, nu [n + 1, M, 4], tau [n, M, 4], link_capacity_kbps [n + 1, M + 1] from path loss alone, and
    with shadowing link_capacity_shadowed_kbps [k, M + 1] at message_time_s [k].
    """
    trajectory = evaluation.trajectory
    write_arrays(
        folder / "trajectory.npz",
        time_s=trajectory.time,
        eta=trajectory.eta[:, 0],
        nu=trajectory.nu[:, 0],
        tau=trajectory.tau[:, 0],
        link_capacity_kbps=evaluation.link_capacity[:, 0],
        message_time_s=messages.time,
        link_capacity_shadowed_kbps=messages.link_capacity,
    )


def write_iterations(folder: Path, records: Sequence[IterationRecord], costs: Sequence[float | None] = ()) -> None:
    """iterations.csv: one row for each policy iteration; empty cells are not known.

    Args:
        folder: folder of the run.
        records: of all iterations so far.
        costs: J of each iterate, None for those that were not flown again; empty before the missions.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(ITERATION_COLUMNS)
    for record, cost in zip_longest(records, costs):
        numbers = (record.weight_change, record.residual, record.condition, cost)
        told = ["" if number is None else f"{number:.10g}" for number in (record.seconds, *numbers)]
        table.writerow([record.iteration, told[0], record.rows, *told[1:], int(record.converged)])
    write_whole(folder / "iterations.csv", text.getvalue().encode())


def read_iterations(folder: Path) -> list[tuple[float, float]]:
    """Vehicle seconds and J of the iterates in iterations.csv that were flown again.

    Raises:
        OSError: the file is missing or cannot be read.
        ValueError: it was not written by `write_iterations`.
    """
    text = read_whole(folder / "iterations.csv", MOST_BYTES).decode()
    table = csv.DictReader(io.StringIO(text))
    if list(table.fieldnames or []) != list(ITERATION_COLUMNS):
        raise ValueError("not the iterations of a run")
    rows = [(row["vehicle_seconds"], row["cost_total"]) for row in table]
    return [(float(seconds), float(cost)) for seconds, cost in rows if cost]


def write_layouts(folder: Path, layouts: Layouts, outcomes: Outcomes) -> None:
    """layouts.npz of N worlds: start [N, M, 4], centre [N, O, 2], nan of absent obstacles, radius, and Outcomes."""
    obstacles = layouts.obstacles
    write_arrays(
        folder / "layouts.npz",
        start=layouts.start,
        centre=obstacles.centre.where(obstacles.present[..., None], math.nan),
        radius=obstacles.radius,
        **{field.name: getattr(outcomes, field.name) for field in fields(outcomes)},
    )


def write_estimate(folder: Path, snr_map: SnrMap, diagnostics: Diagnostics, line: Tensor) -> None:
    """estimate.npz: the map [Y, X] over x_m and y_m, and of m readings line and residual."""
    write_arrays(
        folder / "estimate.npz",
        x_m=snr_map.grid.x,
        y_m=snr_map.grid.y,
        z_m=snr_map.grid.z,
        from_m=snr_map.sender,
        snr_mean_dB=snr_map.mean,
        snr_std_dB=snr_map.std,
        capacity_kbps=snr_map.capacity,
        outage=snr_map.outage,
        line=line,
        residual_dB=diagnostics.residual,
        standardized=diagnostics.standardized,
    )
