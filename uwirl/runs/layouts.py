"""`scenario.layouts`: what was learned, flown in many random layouts instead of the scenario's own."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from uwirl import build
from uwirl.config.schema import Config
from uwirl.motion.policy import Policy
from uwirl.motion.targets import mean_channel_targets
from uwirl.runs import pictures
from uwirl.study.campaign import fly
from uwirl.study.evaluation import Evaluation
from uwirl.study.whole_files import write_arrays
from uwirl.world.relay import Relay

log = logging.getLogger("uwirl")

# Worlds flown together: their trajectories take about 100 MB.
BATCH = 250


def campaign(config: Config, policy_in: Callable[[Relay], Policy], folder: Path) -> dict[str, Any]:
    """Fly every layout, write layouts.npz and the figure; returns entries of metrics.json.

    Args:
        config: with `scenario.layouts`.
        policy_in: the learned policy for some of the worlds.
        folder: of the run.
    """
    assert config.scenario.layouts is not None
    env, layouts = build.make_layouts(config)
    targets = mean_channel_targets(env.scenario, env.channel)
    cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
    shown: list[tuple[Relay, Evaluation]] = []
    flown = 0

    def watch(worlds: Relay, evaluation: Evaluation) -> None:
        nonlocal flown
        flown += worlds.worlds
        log.info("  flown: %d of %d layouts", flown, len(layouts.kind))
        if not shown:
            shown.append((worlds, evaluation))

    outcomes = fly(env, layouts, policy_in, cost, targets, build.make_guard(config), BATCH, watch)
    for line in outcomes.table():
        log.info("%s", line)
    names = ("kind", "feasible", "ambiguous", "collisions", "clearance", "separation", "t99", "blocked", "cost")
    fields = {name: getattr(outcomes, name).numpy(force=True) for name in names}
    start, obstacles = layouts.start.numpy(force=True), layouts.obstacles
    write_arrays(
        folder / "layouts.npz",
        start=start,
        centre=torch.where(obstacles.present[..., None], obstacles.centre, torch.nan).numpy(force=True),
        radius=obstacles.radius.numpy(force=True),
        **fields,
    )
    pictures.layouts(config.logging, folder, *shown[0], layouts.kind)
    return outcomes.metrics()
