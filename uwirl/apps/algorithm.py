"""Algorithm 1, from readings to a flown mission, and what it leaves in its run folder."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

import uwirl
from uwirl import build
from uwirl.apps import pictures
from uwirl.apps.layouts import campaign
from uwirl.apps.progress import Progress
from uwirl.apps.summary import table
from uwirl.config.schema import Config, IrlConfig, PlannerConfig
from uwirl.irl.policy_iteration import InadmissiblePolicyError, InsufficientDataError, IterationRecord
from uwirl.motion.planner import LearningPlanner, Planner
from uwirl.motion.policy import Policy
from uwirl.motion.targets import NoTargetError, mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.snr.model import UnidentifiableError
from uwirl.study import checkpoint, run_folder, shadowing
from uwirl.study.evaluation import Evaluation, cost_of_weights, evaluate
from uwirl.study.tensorboard import TensorBoard
from uwirl.world.relay import DivergedError, Relay

log = logging.getLogger("uwirl")

# What a run may end in without being a bug: its message goes into metrics.json.
FAILURES = (
    DivergedError,
    InadmissiblePolicyError,
    InsufficientDataError,
    UnidentifiableError,
    NoTargetError,
    ArithmeticError,
    torch.linalg.LinAlgError,
)


def run(config: Config, experiment: str, folder: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Run one experiment and write its folder.

    Args:
        config: validated.
        experiment: its name.
        folder: existing, where everything is written.
        overrides: of the command line, to be told apart from others of a sweep.

    Returns:
        What metrics.json holds; `status` is "failed", with `error`, after one of FAILURES. Anything else that is raised
        is written there too, and raised on.
    """
    torch.set_num_threads(config.threads)
    started = time.perf_counter()
    metrics: dict[str, Any] = {
        "status": "failed",
        "error": None,
        "experiment": experiment,
        "overrides": list(overrides),
        "config_hash": run_folder.config_hash(config),
        "seed": config.seed,
        "uwirl_version": uwirl.__version__,
    }
    run_folder.write_config(folder, config)
    try:
        metrics |= _algorithm_1(config, folder)
        metrics["status"] = "complete"
    except FAILURES as error:
        metrics["error"] = f"{type(error).__name__}: {error}"
        log.error("failed: %s", error)
    except BaseException as error:
        metrics["error"] = f"{type(error).__name__}: {error}"
        raise
    finally:
        metrics["wall_time_s"] = time.perf_counter() - started
        run_folder.write_metrics(folder, metrics)
    log.info("%s in %.1f s; everything lies in %s", metrics["status"], metrics["wall_time_s"], folder)
    return metrics


@torch.no_grad()
def _algorithm_1(config: Config, folder: Path) -> dict[str, Any]:
    board = TensorBoard(folder / "tb") if config.logging.tensorboard else None
    env = build.make_relay(config)

    readings, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator))
    for line in str(estimate).splitlines():
        log.info("channel estimate: %s", line)
    if board:
        board.config(config)
        board.estimate(estimate)

    planner = build.make_planner(config, config.planner, env)
    policy, records = _plan(config, planner, env, estimate, board)

    if config.scenario.layouts is not None:
        learned = {}
        if isinstance(planner, LearningPlanner) and records:
            learned = _learning_metrics(config, planner, records)
            checkpoint.save(folder / "checkpoints" / "last.pt", _checkpoint(config, estimate, records[-1], learned))
        outcomes = campaign(config, lambda worlds: build.policy_in(worlds, config, planner, estimate), folder)
        return run_folder.estimate_metrics(estimate) | learned | outcomes

    judge = _Judge(config, env)
    evaluation = judge.fly(policy)
    rows = {config.planner.name: evaluation}
    metrics = run_folder.estimate_metrics(estimate) | evaluation.metrics()
    metrics |= shadowing.summary(env, evaluation.trajectory, judge.targets, readings, estimate)
    if isinstance(planner, LearningPlanner) and records:
        start, costs = judge.iterates(planner, records)
        rows = {"start policy": start, **judge.baseline(estimate), **rows}
        metrics |= _learning_metrics(config, planner, records)
        metrics["converged"] = records[-1].converged and _settled(config.planner, evaluation)
        metrics |= {"cost_total_start_policy": float(start.cost[0]), "cost_per_iteration": costs}
        checkpoint.save(folder / "checkpoints" / "last.pt", _checkpoint(config, estimate, records[-1], metrics))
        if board:
            board.cost_per_iteration(costs)
    messages = shadowing.messages(env, evaluation.trajectory)
    run_folder.write_trajectory(folder, evaluation, messages)
    picture = pictures.mission(config.logging, folder, env, evaluation, messages, records, planner)
    if board:
        board.evaluation(evaluation, messages)
        if picture:
            board.picture(picture)
        board.compare(config, metrics)
        board.close()
    for line in table(rows):
        log.info("%s", line)
    return metrics


def _plan(
    config: Config, planner: Planner, env: Relay, estimate: ChannelEstimate, board: TensorBoard | None
) -> tuple[Policy, list[IterationRecord]]:
    """Fit the planner, watching its iterations where it has any."""
    if not isinstance(planner, LearningPlanner):
        return planner.fit(env, estimate), []
    assert isinstance(config.planner, IrlConfig)
    records = []
    progress = Progress(config.planner.max_time_s, config.logging.progress)
    for record in planner.iterate(env, estimate):
        records.append(record)
        progress.update(record)
        if board:
            board.iteration(record, planner.basis)
    progress.close()
    last = records[-1]
    log.info(
        "learned in %d policy iterations from %.0f s of flight%s",
        last.iteration,
        last.seconds,
        ", weights settled" if last.converged else "",
    )
    return planner.lead(planner.policy), records


class _Judge:
    """Flies policies on the true channel, from the scenario's start."""

    def __init__(self, config: Config, env: Relay):
        self.config = config
        self.env = env
        self.targets = mean_channel_targets(env.scenario, env.channel)
        self.cost = build.make_cost(config.cost, env.channel, self.targets, env.vehicle.tau_max)
        self.guard = build.make_guard(config)

    def fly(self, policy: Policy) -> Evaluation:
        return evaluate(self.env, policy, self.cost, self.targets, self.env.reset(), self.guard)

    def iterates(self, planner: LearningPlanner, records: list[IterationRecord]) -> tuple[Evaluation, list[float]]:
        """The start policy's mission, and J of every iterate."""
        learned = planner.policy.actor.weight.clone()
        planner.policy.actor.weight.copy_(planner.start_weights)
        start = self.fly(planner.lead(planner.policy))
        planner.policy.actor.weight.copy_(learned)
        weights = torch.stack([record.actor[: self.env.scenario.vehicles] for record in records])
        starts = self.env.scenario.start[None]
        costs = cost_of_weights(
            self.env, planner.policy, weights, self.cost, self.targets, starts, planner.lead, self.guard
        )
        return start, costs[:, 0].tolist()

    def baseline(self, estimate: ChannelEstimate) -> dict[str, Evaluation]:
        planner = build.make_planner(self.config, self.config.baseline, self.env)
        return {self.config.baseline.name: self.fly(planner.fit(self.env, estimate))}


def _learning_metrics(config: Config, planner: LearningPlanner, records: list[IterationRecord]) -> dict[str, Any]:
    last = records[-1]
    return {
        "learning_vehicle_seconds": last.seconds,
        "learning_env_steps": round(last.seconds / config.scenario.dt_s),
        "learning_collisions": planner.recorder.contacts,
        "policy_iterations": last.iteration,
    }


def _settled(planner: PlannerConfig, evaluation: Evaluation) -> bool:
    """epsilon_4: whether 1/C no longer changes over a window at the end of the mission."""
    assert isinstance(planner, IrlConfig)
    inverse = 1.0 / evaluation.chain_capacity[:, 0]
    window = round(planner.window_s / evaluation.trajectory.dt)
    return float((inverse[-1] - inverse[-1 - window]).abs()) < planner.tolerance_inverse_capacity


def _checkpoint(
    config: Config, estimate: ChannelEstimate, record: IterationRecord, metrics: dict[str, Any]
) -> dict[str, Any]:
    return {
        "uwirl_version": uwirl.__version__,
        "config": asdict(config),
        "iteration": record.iteration,
        "vehicle_seconds": record.seconds,
        "critic": record.critic,
        "actor": record.actor,
        "estimate": {
            name: getattr(estimate, name) for name in ("value", "covariance", "identifiable", "cost", "evaluations")
        },
        "metrics": metrics,
    }
