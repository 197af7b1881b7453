"""How far planners stay above a trajectory optimiser that knows the dynamics, in J.

    python experiments/compare.py

The reference is the best of several IPOPT runs (seeded with the way on the map at two speeds, and with the first
planner's own flight): a good trajectory, not a proven lower bound. The gap is J / J_reference - 1.

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import hydra
import torch
from learned import shown
from learning_curve import STARTS
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave
from torch import Tensor

from uwirl import build
from uwirl.algorithm import Planned, algorithm_1
from uwirl.baselines.guesses import guess_from, guesses_on_the_map
from uwirl.baselines.trajectory_optimization import Plan, optimise
from uwirl.config.compose import compose
from uwirl.config.schema import Config
from uwirl.config.validate import validate
from uwirl.motion.cost import CostWeights
from uwirl.motion.mission import Mission
from uwirl.study import style
from uwirl.study.colours import BLUE
from uwirl.study.evaluation import Evaluation, Evaluator
from uwirl.study.progress import bar
from uwirl.world.agent import Agent
from uwirl.world.layouts import KINDS, draw_layouts
from uwirl.world.obstacles import contacts, no_obstacles
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

log = logging.getLogger("uwirl")


@dataclass(frozen=True)
class Rival:
    """A planner that has finished learning."""

    config: Config
    agent_in: Callable[[Relay], Agent]

    @classmethod
    def learn(cls, overrides: list[str]) -> Rival:
        config = compose(overrides)
        validate(config)
        torch.set_num_threads(config.threads)
        env = build.make_relay(config)
        estimator = build.make_estimator(config.estimator, env)
        *_, planned = shown(algorithm_1(env, estimator, build.make_planner(config, config.planner, env)), config)
        assert isinstance(planned, Planned)
        return cls(config, planned.agent_in)

    def fly(self, worlds: Relay, weights: CostWeights) -> Evaluation:
        """Its missions, with its own detection range."""
        seen = replace(worlds.scenario, detection_range=self.config.scenario.detection_range_m)
        worlds = worlds.on(seen, worlds.streams)
        guard, progress = build.make_guard(self.config, worlds), self.config.logging.progress
        return Evaluator(worlds, weights, guard, progress).fly(self.agent_in(worlds))


def reference(mission: Mission, flown: Evaluation, world: int, settings: DictConfig) -> Plan:
    """The best trajectory found in one world."""
    guesses = guesses_on_the_map(mission, settings.speeds_mps, settings.intervals, world)
    guesses.append(guess_from(flown.trajectory, world, settings.intervals))
    return optimise(mission, guesses, settings.intervals, world)


def problems(settings: DictConfig, env: Relay, targets: Tensor) -> dict[str, tuple[Relay, list[str]]]:
    """Batches of worlds, and the names of these: the configuration's own, twelve starts in free water, layouts.

    Args:
        settings: of this script.
        env: the configuration's own world.
        targets: of the vehicles there, [M, 3], m.
    """
    streams = RandomStreams.worlds(settings.seed, settings.layouts)
    drawn = draw_layouts(streams, list(settings.kinds), targets)
    starts = STARTS[1:, None, :4]
    free = replace(env.scenario, start=starts, obstacles=no_obstacles())
    cluttered = replace(env.scenario, start=drawn.start, obstacles=drawn.obstacles)
    numbered = [f"{KINDS[k]} {world}" for world, k in enumerate(drawn.kind.tolist())]
    return {
        "own": (env, ["own"]),
        "free": (env.on(free, RandomStreams.worlds(settings.seed, len(starts))), [f"start {k}" for k in range(1, 13)]),
        "layouts": (env.on(cluttered, streams), numbered),
    }


def compare(settings: DictConfig) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """metrics.json, and the gaps of all planners over the layouts that count, [layouts]."""
    overrides = list(settings.overrides)
    rivals = {name: Rival.learn(overrides + list(own)) for name, own in settings.planners.items()}
    first = next(iter(rivals.values()))
    env = build.make_relay(first.config)
    channel, weights = truth_of(env).channel, build.make_cost(first.config.cost)
    targets = Mission(env, channel, weights).targets.frame.target
    metrics: dict[str, Any] = {}
    gaps: dict[str, Tensor] = {}
    for problem, (worlds, names) in problems(settings, env, targets).items():
        flown = {name: rival.fly(worlds, weights) for name, rival in rivals.items()}
        mission, plans = Mission(worlds, channel, weights), []
        with bar("optimising", len(names), first.config.logging.progress) as progress:
            for world, name in enumerate(names):
                plans.append(reference(mission, next(iter(flown.values())), world, settings))
                J = " ".join(f"{float(flight.cost[world]):8.3f}" for flight in flown.values())
                log.info("%-16s %8.3f%s %s", name, plans[-1].cost, " " if plans[-1].converged else "*", J)
                progress.update()
        way = worlds.start().vehicles.position[..., :2] - targets[:, :2]
        far = torch.linalg.vector_norm(way, dim=-1).amin(-1) >= (settings.least_way_m if problem == "layouts" else 0.0)
        counted = far & torch.tensor([plan.converged for plan in plans])
        best = torch.tensor([plan.cost for plan in plans], dtype=torch.float64)
        metrics |= {f"{problem}_converged": int(counted.sum()), f"{problem}_worlds": len(plans)}
        if problem != "layouts":
            metrics[f"{problem}_cost_reference"] = best.tolist()
        for name, flight in flown.items():
            gap = 100.0 * (flight.cost / best - 1.0)[counted]
            metrics |= summary(f"{problem}_{slug(name)}", flight, gap)
            if problem == "layouts":
                gaps[name] = gap
    return metrics, gaps


def slug(name: str) -> str:
    """A planner's name as part of a key."""
    return re.sub(r"\W+", "_", name)


def summary(key: str, flight: Evaluation, gap: Tensor) -> dict[str, Any]:
    """A planner on a problem: its gap in %, who arrived, who touched."""
    worlds = flight.cost.shape[0]
    arrived = sum(flight.time_to_99_percent(world) is not None for world in range(worlds))
    return {
        f"{key}_cost_total": flight.cost.tolist() if worlds <= len(STARTS) else None,
        f"{key}_gap_median_percent": float(gap.median()),
        f"{key}_gap_max_percent": float(gap.max()),
        f"{key}_reach_rate": arrived / worlds,
        f"{key}_collisions": int(contacts(flight.clearance).sum()),
    }


def table(metrics: dict[str, Any], problem: str, planners: list[str]) -> None:
    """Log a planner a line."""
    log.info(
        "%s: %d of %d references converged and count",
        problem,
        *(metrics[f"{problem}_{k}"] for k in ("converged", "worlds")),
    )
    log.info("  %-20s %10s %10s %8s %10s", "planner", "median (%)", "worst (%)", "reached", "collisions")
    for name in planners:
        key = f"{problem}_{slug(name)}"
        columns = ("gap_median_percent", "gap_max_percent", "reach_rate", "collisions")
        log.info("  %-20s %10.1f %10.1f %8.2f %10d", name, *(metrics[f"{key}_{column}"] for column in columns))


@style.paper
def gap_figure(gaps: Mapping[str, Tensor]) -> Figure:
    """Gap of J to the optimiser, in %: one point per layout for each planner, and the median."""
    figure = style.new(style.PAGE, 0.36 * len(gaps) + 0.6)
    axes = figure.subplots()
    for row, gap in enumerate(gaps.values()):
        axes.plot(gap.clamp_min(0.1), row + torch.linspace(-0.25, 0.25, len(gap)), ".", color=BLUE, ms=3)
        median = float(gap.median())
        axes.plot([median, median], [row - 0.35, row + 0.35], "k")
        axes.annotate(f"{median:.1f} %", (median, row - 0.37), ha="center", va="bottom")
    axes.set_yticks(range(len(gaps)), list(gaps))
    axes.set(xscale="log", xlabel="$J$ above the trajectory optimiser's (%)")
    axes.invert_yaxis()
    axes.grid(axis="x", which="both")
    return figure


@hydra.main(version_base="1.3", config_path="conf", config_name="compare")
def main(settings: DictConfig) -> None:
    """Print the tables, write metrics.json and the figure."""
    log.info("%-16s %8s  %s", "J", "optimum", " ".join(f"{name[:8]:>8}" for name in settings.planners))
    with torch.no_grad():
        metrics, gaps = compare(settings)
    for problem in ("own", "free", "layouts"):
        table(metrics, problem, list(settings.planners))
    leave(metrics, gap_figure(gaps))


if __name__ == "__main__":
    main()
