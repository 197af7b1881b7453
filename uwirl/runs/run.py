"""Runs of `uwirl` and `uwirl-evaluate`: a mission on the true channel, written to a run folder.

The agent comes from Algorithm 1, or from a checkpoint.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.algorithm import Estimated, Event, Modelled, Planned, algorithm_1
from uwirl.config.cautions import cautions
from uwirl.config.overrides import effective
from uwirl.config.schema import Config
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import Learning
from uwirl.runs.interruption import Interruption
from uwirl.runs.listeners import Board, Legs, Listener, Narrator
from uwirl.runs.missions import Course, MissionFlight, campaign
from uwirl.runs.recorded import recorded, warn
from uwirl.runs.saving import Checkpoints, Origin
from uwirl.snr.plausibility import implausible
from uwirl.study import checkpoint, run_files, run_folder
from uwirl.study.learning_file import load, other_budget, take_estimate, take_model, take_trim, take_weights
from uwirl.study.progress import bar
from uwirl.study.tensorboard import TensorBoard
from uwirl.study.warnings import NO_MODEL, learning_warnings, mission_warnings
from uwirl.world.agent import Agent
from uwirl.world.readings import readings_of_each_vehicle
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")


def run(config: Config, experiment: str, folder: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Run one experiment and write its folder.

    Args:
        config: a validated configuration.
        experiment: name of the experiment.
        folder: an existing folder for everything that is written.
        overrides: overrides on the command line; they tell the runs of a sweep apart.

    Returns:
        Content of metrics.json, see `uwirl.runs.recorded`.
    """
    torch.set_num_threads(config.threads)

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        origin = Origin.of(config)
        settings = replace(config, resume=None)
        metrics |= {"overrides": effective(overrides), "config_hash": origin.config_hash(settings)}
        run_folder.write_config(folder, settings)
        for sentence in cautions(settings):
            warn(sentence)
        records, config_hash = origin.records(), metrics["config_hash"]
        checkpoints = Checkpoints(folder, settings, config_hash, overrides, records, interruption)
        with TensorBoard(folder / "tb" if config.logging.tensorboard else None) as board:
            board.config(settings)
            metrics |= _work(settings, folder, origin, checkpoints, board)
            board.compare(experiment, config.seed, overrides, metrics)

    return recorded(work, experiment, config.seed, folder)


@torch.no_grad()
def _work(config: Config, folder: Path, origin: Origin, checkpoints: Checkpoints, board: TensorBoard) -> dict[str, Any]:
    env = build.make_relay(config)
    planner, estimator = build.make_planner(config, config.planner, env), build.make_estimator(config.estimator, env)
    if config.scenario.layouts is None:
        for sentence in mission_warnings(env):
            warn(sentence)
    records = checkpoints.records
    if records:
        log.info("continues after iteration %d, %.0f s of flight", records[-1].iteration, records[-1].seconds)
    events = algorithm_1(env, estimator, planner, origin.start(env))
    shown = config.logging.progress and isinstance(planner, IrlPlanner)
    with bar("learning", getattr(config.planner, "max_time_s", 0.0), shown) as progress:
        legs, told = Legs(), Board(board, records, checkpoints.every)
        listeners: list[Listener] = [Narrator(progress), _doubt, told, legs, checkpoints]
        ends = _heard(events, listeners, checkpoints.interruption)
    estimated, planned, modelled = ends[Estimated], ends[Planned], ends.get(Modelled)
    metrics = run_files.estimate_metrics(estimated.estimate)
    if planned.learned is not None:
        learning, state = planned.learned
        metrics |= run_files.learning_metrics(state, config.scenario.dt_s)
        metrics |= run_files.model_metrics(learning.planner.regressor.names, state.known)
    if modelled is not None:
        learned = modelled.learned
        metrics |= {"learning_vehicle_seconds": learned.seconds, "learning_collisions": learned.contacts}
        metrics |= run_files.model_metrics(modelled.names, learned.identified)
    if config.scenario.layouts is not None:
        return metrics | campaign(config, planned.agent_in, folder)

    flight = MissionFlight(config, env, folder)
    if planned.learned is None:
        agents = {**flight.baseline(estimated.estimate), config.planner.name: planned.agent_in(env)}
        return metrics | flight.report(flight.first(legs.flown) | flight.fly(agents), estimated, board)
    learning, state = planned.learned
    flown, costs = flight.fly_learned(learning, state, records, estimated.estimate)
    flown = flight.first(legs.flown) | flown
    start = float(flown["start policy"].cost[0])
    converged = records[-1].converged and flight.settled(flown[config.planner.name])
    course = Course(records, costs, learning.basis, converged)
    metrics |= flight.report(flown, estimated, board, course) | {"converged": converged}
    for sentence in learning_warnings(records, costs, start, metrics["cost_total"]):
        warn(sentence)
    if state.known is None and flight.has_routes:
        warn(NO_MODEL)
    metrics |= {"cost_total_start_policy": start, "cost_per_iteration": costs}
    checkpoints.best(learning, state, costs)
    checkpoints.last(learning, state, metrics)
    board.cost_per_iteration(costs)
    return metrics


def _doubt(event: Event) -> None:
    """Warn of readings and estimates that cannot be true, before anything is planned with them."""
    if isinstance(event, Estimated):
        for i, readings in enumerate(event.readings):
            for sentence in implausible(readings, event.estimate.select(torch.tensor([i]))):
                warn(f"channel of vehicle {i + 1}: {sentence}")


def _heard(events: Iterator[Event], listeners: Sequence[Listener], interruption: Interruption) -> dict[type, Any]:
    """Pass all events to the listeners; returns the last one of each type."""
    ends: dict[type, Any] = {}

    def hear(event: Event) -> None:
        ends[type(event)] = event
        for listen in listeners:
            listen(event)

    hear(next(events))
    # A leg that is cut short cannot be used, nor be continued identically.
    with interruption.postponed():
        for event in events:
            hear(event)
    return ends


def evaluate(config: Config, experiment: str, folder: Path, path: Path) -> dict[str, Any]:
    """Fly a checkpoint's policy and write the run folder.

    Args:
        config: a validated configuration, with the scenario to fly.
        experiment: name of the experiment.
        folder: an existing folder for everything that is written.
        path: path of the checkpoint.

    Returns:
        Content of metrics.json: the entries of a run without those of learning, and `checkpoint`.
    """
    torch.set_num_threads(config.threads)

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        content = load(path, config.device)
        metrics["config_hash"] = run_folder.config_hash(config, checkpoint.digest(path))
        metrics |= {"checkpoint": str(path), "checkpoint_iteration": content["iteration"]}
        run_folder.write_config(folder, config)
        for sentence in cautions(config):
            warn(sentence)
        metrics |= _evaluated(config, folder, path, content)

    return recorded(work, experiment, config.seed, folder)


@torch.no_grad()
def _evaluated(config: Config, folder: Path, path: Path, content: dict[str, Any]) -> dict[str, Any]:
    env = build.make_relay(config)
    estimate = take_estimate(path, content, env.budget, env.scenario.vehicles)
    problem = other_budget(path, content, env.budget)
    if problem:
        warn(problem)
    planner = build.make_planner(config, config.planner, env)
    assert isinstance(planner, IrlPlanner)
    learning = Learning(planner, env, estimate)
    weights = take_weights(path, content, learning.basis, learning.learners)
    trim, known = take_trim(path, content, learning.learners), take_model(path, content, planner.regressor.names)

    def agent_in(worlds: Relay) -> Agent:
        return learning.agent(weights, trim, worlds, known)

    metrics = run_files.estimate_metrics(estimate) | run_files.model_metrics(planner.regressor.names, known)
    if config.scenario.layouts is not None:
        return metrics | campaign(config, agent_in, folder)
    flight = MissionFlight(config, env, folder)
    flown = flight.fly({**flight.baseline(estimate), config.planner.name: agent_in(env)})
    return metrics | flight.report(flown, Estimated(readings_of_each_vehicle(env), estimate))
