"""Learning among obstacles from the first second: one independent learner in each of many cluttered worlds.

    python experiments/learning_in_clutter.py

Every learner starts somewhere else among obstacles of its own, learns by virtual links behind the guard, and then flies
the mission in its world with the weights that it has found. The same learning without the guard tells what the guard
saves: hulls then pass through cylinders.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import hydra
import torch
from learned import Learned, learn
from omegaconf import DictConfig
from results import leave
from torch import Tensor

from uwirl import build
from uwirl.algorithm import Start
from uwirl.config.compose import compose
from uwirl.config.schema import Config
from uwirl.config.validate import validate
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study.campaign import fly, upper_bound
from uwirl.world.agent import Guard
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")


class Watched:
    """A guard that notes the smallest clearance of each world.

    Args:
        guard: who does the work.
        env: B worlds, whose vehicles know where they are.
    """

    def __init__(self, guard: Guard, env: Relay):
        self.guard, self.scenario = guard, env.scenario
        self.clearance = torch.full((env.worlds,), torch.inf, dtype=torch.float64)  # [B], m

    def __call__(self, tau: Tensor, observation: Observation) -> Tensor:
        clearance = self.scenario.clearance(observation.position, observation.time).amin(-1)
        self.clearance = torch.minimum(self.clearance, clearance)
        return self.guard(tau, observation)


def learn_in_clutter(config: Config, env: Relay) -> tuple[Learned, dict[str, Any]]:
    """All learners at once, each with weights and random numbers of its own; also entries of metrics.json."""
    one = build.make_relay(config)
    _, estimate = estimate_each_vehicle(one, build.make_estimator(config.estimator, one))
    planner = build.make_planner(config, config.planner, env)
    if not isinstance(planner, IrlPlanner) or planner.experience.learners(env) != env.worlds:
        raise SystemExit("needs planner=irl and experience=virtual_links: a learner for each world")
    watched = Watched(build.make_guard(config, env), env)
    learned = learn(config, env, replace(planner, guard=watched), Start(estimate))
    hit = int((watched.clearance < 0.0).sum())
    return learned, {
        "learning_vehicle_seconds": learned.state.seconds * env.worlds,
        "learning_collisions": learned.state.contacts,
        "learning_worlds_with_collision": hit,
        "learning_collision_rate_upper_95": upper_bound(hit, env.worlds),
        "learning_min_obstacle_clearance_m": float(watched.clearance.min()),
    }


def learning_in_clutter(settings: DictConfig) -> dict[str, Any]:
    """metrics.json; what concerns learning without the guard has the prefix `unguarded_`."""
    drawn = {"count": settings.worlds, "seed": settings.seed, "kinds": settings.kinds}
    overrides = [*settings.overrides, *(f"scenario.layouts.{key}={value}" for key, value in drawn.items())]
    config = compose(overrides)
    validate(config)
    torch.set_num_threads(config.threads)
    common, layouts = build.make_layouts(config)
    env = common.on(replace(common.scenario, start=layouts.start, obstacles=layouts.obstacles), common.streams)
    learned, metrics = learn_in_clutter(config, env)
    log.info("  learned: %d worlds, %.0f s in all", env.worlds, metrics["learning_vehicle_seconds"])
    # In one batch, or weights would come to the wrong vehicles.
    missions = fly(env, layouts, learned.agent_in, build.make_evaluator(config, env), env.worlds)
    metrics |= missions.metrics()
    if settings.also_unguarded:
        _, careless = learn_in_clutter(compose([*overrides, "safety=none"]), env)
        metrics |= {f"unguarded_{key}": value for key, value in careless.items()}
    return metrics


def table(metrics: dict[str, Any]) -> None:
    """Log the flights: learning with and without the guard, and the missions."""
    log.info("%-20s %9s %8s %10s %8s %9s", "", "time (s)", "contacts", "in worlds", "hit <", "clear (m)")
    columns = ("collisions", "worlds_with_collision", "collision_rate_upper_95", "min_obstacle_clearance_m")
    flights = {"learning": "learning_", "learning, no guard": "unguarded_learning_", "missions": ""}
    for name, prefix in flights.items():
        if f"{prefix}collisions" in metrics:
            seconds = metrics.get(f"{prefix}vehicle_seconds", float("nan"))
            row = [metrics[f"{prefix}{column}"] for column in columns]
            log.info("%-20s %9.0f %8d %10d %8.2f %9.3f", name, seconds, *row)
    reached, feasible, cost = (metrics[key] for key in ("reach_rate", "worlds_feasible", "cost_total_median"))
    log.info("reached: %.3f of %d feasible worlds; J, median: %.3f", reached, feasible, cost)


@hydra.main(version_base="1.3", config_path="conf", config_name="learning_in_clutter")
def main(settings: DictConfig) -> None:
    """Print the table and write metrics.json."""
    with torch.no_grad():
        metrics = learning_in_clutter(settings)
    table(metrics)
    leave(metrics)


if __name__ == "__main__":
    main()
