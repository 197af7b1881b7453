"""Planners on a fleet of vehicles in random layouts: what each costs, who arrives, who touches.

    python experiments/fleet.py
    python experiments/fleet.py 'vehicles=[random]' seeds=10 layouts=1

Every planner learns on its vehicle in the world of Fig. 5 and then flies the same layouts on the channel that was
estimated there. J is judged on the true channel.

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any

import hydra
import torch
from compare import Rival, slug
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave

from uwirl import build
from uwirl.motion.mission import Mission
from uwirl.study import style
from uwirl.study.evaluation import Evaluation
from uwirl.study.plan_view import draw_plan
from uwirl.world.layouts import draw_layouts
from uwirl.world.obstacles import contacts
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

log = logging.getLogger("uwirl")

# Panels of the figure.
MOST_DRAWN = 9


def layouts_of(config: Any, settings: DictConfig) -> Relay:
    """The layouts, for the vehicle of a configuration."""
    env = build.make_relay(config)
    targets = Mission(env, truth_of(env).channel).targets.frame.target
    streams = RandomStreams.worlds(settings.layout_seed, settings.layouts)
    drawn = draw_layouts(streams, list(settings.kinds), targets)
    return env.on(replace(env.scenario, start=drawn.start, obstacles=drawn.obstacles), streams)


def told(name: str, vehicle: str, flown: Evaluation) -> dict[str, Any]:
    """Log a planner's row; its entries of metrics.json."""
    arrived, hit = int(flown.arrival.isfinite().sum()), int(contacts(flown.clearance).sum())
    J = flown.cost
    log.info(
        "%-16s %-12s %8.3f %8.3f %8.3f %6d of %d %9d", vehicle, name, J.sum(), J.median(), J.max(), arrived, len(J), hit
    )
    key = f"{slug(vehicle)}_{slug(name)}"
    return {f"{key}_cost_total": J.tolist(), f"{key}_reached": arrived, f"{key}_collisions": hit}


@style.paper
def draw(flown: dict[str, tuple[Relay, Evaluation]], world: int) -> Figure:
    """Paths of the last planner's vehicles in one layout."""
    columns = 3
    rows = -(-len(flown) // columns)
    figure = style.new(style.PAGE, rows * (style.PAGE / columns + 0.1))
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flatten()
    for axes, (name, (env, evaluation)) in zip(panels, flown.items(), strict=False):
        scenario = env.scenario.worlds(torch.tensor([world]))
        scenario = replace(scenario, obstacles=scenario.obstacles.each(lambda field: field[0]))
        draw_plan(axes, scenario, evaluation.trajectory.eta[:, world].numpy(force=True), arrows=6)
        axes.set_title(f"{name}: J = {float(evaluation.cost[world]):.2f}")
        axes.label_outer()
    for axes in panels[len(flown) :]:
        axes.set_visible(False)
    return figure


@hydra.main(version_base="1.3", config_path="conf", config_name="fleet")
@torch.no_grad()
def main(settings: DictConfig) -> None:
    """Fly all, print a row each, and write metrics.json and the figure."""
    metrics: dict[str, Any] = {}
    flown: dict[str, tuple[Relay, Evaluation]] = {}
    log.info(
        "%-16s %-12s %8s %8s %8s %11s %9s", "vehicle", "planner", "J, sum", "median", "worst", "reached", "contacts"
    )
    for vehicle in settings.vehicles:
        for seed in range(settings.seeds):
            for name, own in settings.planners.items():
                rival = Rival.learn([*settings.overrides, f"vehicle={vehicle}", f"seed={seed}", *own])
                worlds = layouts_of(rival.config, settings)
                title = vehicle if settings.seeds == 1 else f"{vehicle} {seed}"
                flight = rival.fly(worlds, build.make_cost(rival.config.cost))
                metrics |= told(name, title, flight)
                flown[title] = worlds, flight
    shown = dict(list(flown.items())[:MOST_DRAWN])
    leave(metrics, draw(shown, min(settings.drawn, settings.layouts - 1)))


if __name__ == "__main__":
    main()
