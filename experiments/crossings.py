"""Vehicles in each other's way, all led by the weights that one vehicle learned alone.

    python experiments/crossings.py

swap   every vehicle starts 0.3 m or so from another's target, in reverse order, with a random heading, among cylinders
       that leave a way of 0.45 m to everybody; in one more world exactly head-on, in free water
cross  vehicles start anywhere, dead ends among the obstacles

The guard alone keeps vehicles apart; two collide where their centres are less than two radii apart.
"""

from __future__ import annotations

import logging
import math
from dataclasses import fields, replace
from typing import Any

import hydra
import torch
from learned import learn
from omegaconf import DictConfig
from results import leave

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.motion.targets import mean_channel_targets
from uwirl.study import campaign
from uwirl.study.campaign import Outcomes, upper_bound
from uwirl.world.layouts import Layouts, draw_layouts
from uwirl.world.obstacles import no_obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

log = logging.getLogger("uwirl")

# Of swaps: noise of starts, their clearance, and the inflation with which every way is open, m; drawn for each kept.
NOISE_M, CLEAR_M, OPEN_M, SPARE = 0.3, 0.5, 0.45, 4
BATCH = 250


def swapped(env: Relay, kinds: list[str], count: int) -> tuple[Relay, Layouts]:
    """At most `count` of the worlds with everybody at another's target; after them free water, exactly head-on."""
    frame = mean_channel_targets(env.scenario, truth_of(env).channel).frame
    ends, M = frame.target, env.scenario.vehicles
    streams = env.streams
    noise = streams.normal(Stream.INITIAL_STATE, 0, 3 * M).view(-1, M, 3)
    heading = streams.between(Stream.INITIAL_STATE, 1, -math.pi, math.pi, M)
    drawn = draw_layouts(streams, kinds, ends)
    layouts = replace(drawn, start=torch.cat([ends.flip(0) + NOISE_M * noise, heading[..., None]], -1))
    gap = layouts.obstacles.clearance(layouts.start[..., :3], env.scenario.vehicle_radius)
    good = (gap >= CLEAR_M).flatten(1).all(-1) & layouts.feasible(ends, OPEN_M)
    kept = good.nonzero()[:count, 0]
    rows = torch.cat([kept, kept[:1]])
    start, obstacles = layouts.start[rows], layouts.obstacles.worlds(rows)
    start[-1] = torch.cat([ends.flip(0), frame.bearing[:, None]], -1)
    obstacles.present[-1] = False
    return env.select(rows), Layouts(start, obstacles, layouts.kind[rows])


def crossings(settings: DictConfig) -> dict[str, Any]:
    """metrics.json: of each mode and number of vehicles, and of all together."""
    config = compose(list(settings.overrides))
    validate(config)
    torch.set_num_threads(config.threads)
    env = build.make_relay(config)
    one = learn(config, env)
    least_m = 2.0 * env.scenario.vehicle_radius
    metrics: dict[str, Any] = {}
    parts = []
    count = settings.worlds // (2 * len(settings.vehicles))
    for M in settings.vehicles:
        chain = replace(env.scenario, start=env.scenario.start.new_zeros(M, 4), obstacles=no_obstacles())
        targets = mean_channel_targets(chain, truth_of(env).channel).frame.target
        streams = RandomStreams.worlds(settings.seed + M, count)
        crossing = draw_layouts(streams, list(settings.kinds.cross), targets)
        spare = env.on(chain, RandomStreams.worlds(settings.seed + M, SPARE * count))
        swaps = swapped(spare, list(settings.kinds.swap), count)
        for mode, (worlds, layouts) in {"swap": swaps, "cross": (env.on(chain, streams), crossing)}.items():
            flown = campaign.fly(worlds, layouts, one.agent_in, build.make_evaluator(config, worlds), BATCH)
            parts.append(flown)
            metrics |= {f"{mode}_{M}_{key}": value for key, value in summary(flown, least_m).items()}
            log.info("  flown: %s of %d vehicles, %d worlds", mode, M, len(layouts.kind))
    everything = Outcomes(*(torch.cat([getattr(part, field.name) for part in parts]) for field in fields(Outcomes)))
    return metrics | summary(everything, least_m)


def summary(outcomes: Outcomes, least_m: float) -> dict[str, Any]:
    """Entries of metrics.json; vehicles collide below `least_m` from centre to centre."""
    worlds, struck = len(outcomes.kind), int((outcomes.separation < least_m).sum())
    vehicles = {"vehicle_collisions": struck, "vehicle_collision_rate_upper_95": upper_bound(struck, worlds)}
    return {key: x for key, x in outcomes.metrics().items() if not key.startswith("reach_rate_")} | vehicles


def table(metrics: dict[str, Any], groups: list[str]) -> None:
    """Log a mode and number of vehicles a line; the last line is all of them."""
    log.info("          worlds  contacts clear (m) apart (m)    struck  feasible   reached   t99 med")
    keys = ["worlds", "collisions", "min_obstacle_clearance_m", "min_vehicle_separation_m", "vehicle_collisions"]
    keys += ["worlds_feasible", "reach_rate", "time_to_99_percent_median_s"]
    for prefix in [*(f"{group}_" for group in groups), ""]:
        row = [metrics[f"{prefix}{key}"] for key in keys]
        log.info("%-7s%s", prefix[:-1] or "all", " ".join(f"{math.nan if x is None else x:>9.4g}" for x in row))
    bounds = [metrics[f"{kind}_rate_upper_95"] for kind in ("collision", "vehicle_collision")]
    log.info("95 %% sure: contacts in less than %.4f, collisions of vehicles in less than %.4f of all worlds", *bounds)


@hydra.main(version_base="1.3", config_path="conf", config_name="crossings")
def main(settings: DictConfig) -> None:
    """Print the table and write it to metrics.json."""
    with torch.no_grad():
        metrics = crossings(settings)
    table(metrics, [f"{mode}_{M}" for mode in ("swap", "cross") for M in settings.vehicles])
    leave(metrics)


if __name__ == "__main__":
    main()
