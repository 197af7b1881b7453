"""What `uwirl-evaluate` does: a checkpoint's policy on its mission, judged on the true channel."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.algorithm import Estimated
from uwirl.config.schema import Config
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import Learning
from uwirl.runs.interruption import Interruption
from uwirl.runs.missions import MissionFlight, campaign
from uwirl.runs.recorded import recorded
from uwirl.study import checkpoint, run_folder
from uwirl.study.learning_file import load, take_estimate, take_trim, take_weights
from uwirl.world.readings import readings_of_each_vehicle


def run(config: Config, experiment: str, folder: Path, path: Path) -> dict[str, Any]:
    """Evaluate and write the run folder.

    Args:
        config: validated; of the scenario to fly.
        experiment: its name.
        folder: existing, where everything is written.
        path: of the checkpoint.

    Returns:
        What metrics.json holds: the entries of a run, but for those of learning, and `checkpoint`.
    """
    torch.set_num_threads(config.threads)

    def work(metrics: dict[str, Any], interruption: Interruption) -> None:
        content = load(path, config.device)
        metrics["config_hash"] = run_folder.config_hash(config, checkpoint.digest(path))
        metrics |= {"checkpoint": str(path), "checkpoint_iteration": content["iteration"]}
        run_folder.write_config(folder, config)
        metrics |= _evaluate(config, folder, path, content)

    return recorded(work, experiment, config.seed, folder)


@torch.no_grad()
def _evaluate(config: Config, folder: Path, path: Path, content: dict[str, Any]) -> dict[str, Any]:
    env = build.make_relay(config)
    estimate = take_estimate(path, content, env.budget, env.scenario.vehicles)
    planner = build.make_planner(config, config.planner, env)
    assert isinstance(planner, IrlPlanner)
    learning = Learning(planner, env, estimate)
    weights = take_weights(path, content, learning.basis, learning.learners)
    agent_in = partial(learning.agent, weights, take_trim(path, content, learning.learners))
    metrics = run_folder.estimate_metrics(estimate)
    if config.scenario.layouts is not None:
        return metrics | campaign(config, agent_in, folder)
    flight = MissionFlight(config, env, folder)
    flown = {**flight.baseline(estimate), config.planner.name: flight.fly(agent_in(env))}
    return metrics | flight.report(flown, Estimated(readings_of_each_vehicle(env), estimate))
