"""Algorithm 1, from readings to a flown mission, and what it leaves in its run folder."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.config.overrides import effective
from uwirl.config.schema import Config, IrlConfig, PlannerConfig
from uwirl.irl.policy_iteration import IterationRecord
from uwirl.motion.planner import IrlPlanner
from uwirl.runs import pictures
from uwirl.runs.interruption import Interruption
from uwirl.runs.judge import Judge
from uwirl.runs.layouts import campaign
from uwirl.runs.learning import learn, learning_metrics
from uwirl.runs.recorded import recorded
from uwirl.runs.saving import Checkpoints, Origin
from uwirl.runs.summary import table
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.world.messages import Readings, readings_of_each_vehicle
from uwirl.study import run_folder, shadowing
from uwirl.study.evaluation import Evaluation
from uwirl.study.tensorboard import TensorBoard
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")


def run(config: Config, experiment: str, folder: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Run one experiment and write its folder.

    Args:
        config: validated.
        experiment: its name.
        folder: existing, where everything is written.
        overrides: the command line that composes the settings, told apart by it from others of a sweep.

    Returns:
        What metrics.json holds; `status` is "failed", with `error`, after one of FAILURES. Anything else that is raised
        is written there too, and raised on.
    """
    torch.set_num_threads(config.threads)

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        origin = Origin.of(config)
        settings = replace(config, resume=None)
        metrics |= {"overrides": effective(overrides), "config_hash": origin.config_hash(settings)}
        run_folder.write_config(folder, settings)
        checkpoints = Checkpoints(folder, settings, metrics["config_hash"], overrides)
        with TensorBoard(folder / "tb" if config.logging.tensorboard else None) as board:
            board.config(settings)
            metrics |= _algorithm_1(settings, folder, origin, checkpoints, interruption, board)
            board.compare(experiment, config.seed, overrides, metrics)

    return recorded(work, experiment, config.seed, folder)


@torch.no_grad()
def _algorithm_1(
    config: Config,
    folder: Path,
    origin: Origin,
    checkpoints: Checkpoints,
    interruption: Interruption,
    board: TensorBoard,
) -> dict[str, Any]:
    env = build.make_relay(config)

    readings, estimate = _stage_1(config, env, origin)
    for line in str(estimate).splitlines():
        log.info("channel estimate: %s", line)
    board.estimate(estimate)

    planner = build.make_planner(config, config.planner, env)
    origin.give_weights(planner)
    records: list[IterationRecord] = []
    if isinstance(planner, IrlPlanner):
        records = learn(config, planner, env, estimate, origin, checkpoints, interruption, board)
        policy = planner.lead(planner.policy)
    else:
        policy = planner.fit(env, estimate)

    if config.scenario.layouts is not None:
        learned = learning_metrics(config, planner, records) if isinstance(planner, IrlPlanner) else {}
        outcomes = campaign(config, lambda worlds: build.policy_in(worlds, config, planner, estimate), folder)
        return run_folder.estimate_metrics(estimate) | learned | outcomes

    judge = Judge(config, env)
    evaluation = judge.fly(policy)
    rows = {config.planner.name: evaluation}
    metrics = run_folder.estimate_metrics(estimate) | evaluation.metrics()
    metrics |= shadowing.summary(env, evaluation.trajectory, judge.targets, readings, estimate)
    if isinstance(planner, IrlPlanner):
        start, costs = judge.iterates(planner, records)
        rows = {"start policy": start, **judge.baseline(estimate), **rows}
        metrics |= learning_metrics(config, planner, records)
        metrics["converged"] = records[-1].converged and _settled(config.planner, evaluation)
        metrics |= {"cost_total_start_policy": float(start.cost[0]), "cost_per_iteration": costs}
        checkpoints.best(planner, estimate, records, costs)
        checkpoints.last(planner, estimate, records, metrics)
        board.cost_per_iteration(costs)
    messages = shadowing.messages(env, evaluation.trajectory)
    run_folder.write_trajectory(folder, evaluation, messages)
    picture = pictures.mission(config.logging, folder, env, evaluation, messages, records, planner)
    board.evaluation(evaluation, messages)
    if picture:
        board.picture(picture)
    for line in table(rows):
        log.info("%s", line)
    return metrics


def _stage_1(config: Config, env: Relay, origin: Origin) -> tuple[list[Readings], ChannelEstimate]:
    """Each vehicle's readings, and the channel behind them unless it was estimated before."""
    known = origin.estimate(env.channel, env.scenario.vehicles)
    if known is None:
        return estimate_each_vehicle(env, build.make_estimator(config.estimator))
    return readings_of_each_vehicle(env), known


def _settled(planner: PlannerConfig, evaluation: Evaluation) -> bool:
    """epsilon_4: whether 1/C no longer changes over a window at the end of the mission."""
    assert isinstance(planner, IrlConfig)
    inverse = 1.0 / evaluation.chain_capacity[:, 0]
    window = round(planner.window_s / evaluation.trajectory.dt)
    return float((inverse[-1] - inverse[-1 - window]).abs()) < planner.tolerance_inverse_capacity
