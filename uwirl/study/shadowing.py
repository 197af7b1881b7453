"""Effect of shadowing on a mission, and accuracy of its prediction."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.motion.shadowed_targets import shadowed_targets
from uwirl.motion.targets import ChainTargets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.kriging import Kriging
from uwirl.world.chunks import at_once
from uwirl.world.readings import Readings
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory
from uwirl.world.truth import truth_of

# Spacing of the map on which predictions are compared with the truth; at most a share of the link, and on long links
# so much more that the map has this many nodes a side.
MAP_SPACING_M, MAP_SHARE, MAP_SIDE = 2.0, 0.125, 256
# Number of messages whose shadowing is evaluated together.
CHUNK = 1024


class LinksAtMessages(NamedTuple):
    """Capacities of the links at the times of messages.

    Attributes:
        time: [k], s.
        link_capacity: capacity with path loss and shadowing, [k, M + 1], kbit/s.
    """

    time: Tensor
    link_capacity: Tensor


def messages(env: Relay, trajectory: Trajectory) -> LinksAtMessages:
    """Link capacities in the first world's mission, every `scenario.message_period`."""
    every = round(env.scenario.message_period / env.scenario.dt)
    position = trajectory.eta[::every, :1, :, :3]
    capacity = [
        truth_of(env).link_capacities_kbps(part, shadowed=True)[:, 0]
        for part in position.split(at_once(CHUNK, position.device))
    ]
    return LinksAtMessages(trajectory.time[::every], torch.cat(capacity))


def shadowed_capacities(env: Relay, trajectory: Trajectory, targets: ChainTargets) -> dict[str, float]:
    """Entries of metrics.json: the chain's capacity with shadowing at the start, at the end and at the optimum.

    Args:
        env: environment of one world.
        trajectory: the mission.
        targets: targets of the mean channel.
    """
    best = shadowed_targets(env.scenario, truth_of(env).snr_dB, targets.frame.target)
    places = torch.cat([trajectory.eta[[0, -1], 0, :, :3], best[None]])
    start, end, optimal = truth_of(env).link_capacities_kbps(places[:, None], shadowed=True)[:, 0].amin(-1).tolist()
    # The search has a finite spacing; the vehicles' final positions, which may be better, are included.
    return {
        "capacity_initial_kbps": start,
        "capacity_final_kbps": end,
        "capacity_optimal_kbps": max(start, end, optimal),
    }


def map_spacing(env: Relay) -> float:
    """Spacing of a map around the nodes that suits the length of their link, m."""
    length = float(torch.linalg.vector_norm(env.scenario.source.double() - env.scenario.destination.double()))
    return min(max(MAP_SPACING_M, 1.5 * length / MAP_SIDE), MAP_SHARE * length)


def map_grid(env: Relay, spacing_m: float) -> tuple[Tensor, Tensor]:
    """Axes x [X] and y [Y] of a horizontal map around the nodes, m; it covers the box of the sensors."""
    ends = torch.stack([env.scenario.source, env.scenario.destination]).double()
    margin = 0.25 * torch.linalg.vector_norm(ends[0] - ends[1])
    low, high = ends.amin(0) - margin, ends.amax(0) + margin
    x, y = (torch.arange(float(low[k]), float(high[k]) + 1e-9, spacing_m, dtype=torch.float64) for k in range(2))
    return x.to(ends.device), y.to(ends.device)


def map_rmse_dB(env: Relay, kriging: Kriging) -> float:
    """RMS error of the kriged SNR of links from source and destination to a map at their mean depth, dB."""
    nodes = [env.scenario.source.double(), env.scenario.destination.double()]
    depth = float(0.5 * (nodes[0][2] + nodes[1][2]))
    spacing = map_spacing(env)
    places = torch.cartesian_prod(*map_grid(env, spacing))
    places = torch.nn.functional.pad(places, (0, 1), value=depth)
    errors = []
    for node in nodes:
        away = places[torch.linalg.vector_norm(places - node, dim=-1) > 0.5 * spacing]
        truth = truth_of(env).snr_dB(node.expand_as(away), away)
        errors.append(kriging.mean(node, away) - truth)
    return float(torch.cat(errors).square().mean().sqrt())


def map_targets(env: Relay, kriging: Kriging, targets: ChainTargets) -> Tensor:
    """Best positions of the vehicles on a map, [M, 3], m."""
    return shadowed_targets(env.scenario, kriging.mean, targets.frame.target)


def summary(
    env: Relay, trajectory: Trajectory, targets: ChainTargets, readings: list[Readings], estimate: ChannelEstimate
) -> dict[str, Any]:
    """All entries of metrics.json about shadowing.

    For one vehicle with identifiable shadowing, also its best position on the map, and the true capacity there.
    """
    metrics: dict[str, Any] = shadowed_capacities(env, trajectory, targets)
    channels = [estimate.select(torch.tensor([i])).channel for i in range(len(readings))]
    maps = [Kriging(data, channel) for data, channel in zip(readings, channels, strict=True)]
    rmse = [map_rmse_dB(env, kriging) for kriging in maps]
    metrics["snr_map_rmse_dB"] = rmse[0] if len(rmse) == 1 else rmse
    if len(maps) == 1 and float(maps[0].zeta2) > 0.0:
        place = map_targets(env, maps[0], targets)
        capacity = truth_of(env).link_capacities_kbps(place[None, None], shadowed=True).amin()
        metrics |= {"map_target_m": place.tolist(), "map_target_capacity_kbps": float(capacity)}
    return metrics
