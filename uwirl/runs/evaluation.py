"""What `uwirl-evaluate` does: a checkpoint's policy on its mission, judged on the true channel."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.config.schema import Config
from uwirl.motion.planner import IrlPlanner
from uwirl.runs import pictures
from uwirl.runs.interruption import Interruption
from uwirl.runs.judge import Judge
from uwirl.runs.layouts import campaign
from uwirl.runs.recorded import recorded
from uwirl.runs.summary import table
from uwirl.world.messages import readings_of_each_vehicle
from uwirl.study import checkpoint, run_folder, shadowing
from uwirl.study.learning_file import load, take_estimate, take_trim, take_weights

log = logging.getLogger("uwirl")


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
    estimate = take_estimate(path, content, env.channel, env.scenario.vehicles)
    planner = build.make_planner(config, config.planner, env)
    assert isinstance(planner, IrlPlanner)
    policy = planner.adopt(
        env,
        estimate,
        lambda basis, learners: take_weights(path, content, basis, learners),
        take_trim(path, content, planner.learners),
    )
    metrics = run_folder.estimate_metrics(estimate)
    if config.scenario.layouts is not None:
        return metrics | campaign(config, lambda worlds: build.policy_in(worlds, config, planner, estimate), folder)
    judge = Judge(config, env)
    evaluation = judge.fly(policy)
    readings = readings_of_each_vehicle(env)
    metrics |= evaluation.metrics() | shadowing.summary(env, evaluation.trajectory, judge.targets, readings, estimate)
    messages = shadowing.messages(env, evaluation.trajectory)
    run_folder.write_trajectory(folder, evaluation, messages)
    pictures.mission(config.logging, folder, env, evaluation, messages, [], planner)
    for line in table({**judge.baseline(estimate), config.planner.name: evaluation}):
        log.info("%s", line)
    return metrics
