"""Random start poses of episodes."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from uwirl.world.geometry import length
from uwirl.world.layouts import ATTEMPTS, SEPARATION_M, START_CLEARANCE_M
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.scenario import Scenario

# Range of start depths, as fractions of the water depth.
DEPTHS = (0.025, 0.8)


def random_starts(scenario: Scenario, targets: Tensor, streams: RandomStreams) -> Tensor:
    """Random poses eta [B, M, 4], a pure function of each world's seed and number.

    They are uniform in depth, heading and a square around the targets' centroid, whose diagonal equals the distance of
    the nodes. Poses close to an obstacle or another vehicle are drawn again.

    Args:
        scenario: nodes, obstacles, depth.
        targets: [M, 3], m.
        streams: random numbers of B worlds.

    Raises:
        RuntimeError: the obstacles leave no room.
    """
    M, half_width = len(targets), 0.5 * math.sqrt(0.5) * float(torch.dist(scenario.source, scenario.destination))
    middle = targets.mean(0).double()
    low = torch.tensor([-half_width, -half_width, -DEPTHS[1] * scenario.depth, -math.pi], device=targets.device)
    high = torch.tensor([half_width, half_width, -DEPTHS[0] * scenario.depth, math.pi], device=targets.device)
    about = torch.cat([middle[:2], middle.new_zeros(2)])
    start = middle.new_empty(len(streams.world), M, 4)
    rows = torch.arange(len(start), device=targets.device)
    for attempt in range(ATTEMPTS):
        draws = streams.select(rows).uniform(Stream.INITIAL_STATE, attempt, 4 * M).view(-1, M, 4)
        start[rows] = about + low + (high - low) * draws
        rows = rows[~_roomy(scenario, start[rows])]
        if not len(rows):
            return start.to(targets.dtype)
    raise RuntimeError(f"no start clear of obstacles and other vehicles in {ATTEMPTS} attempts")


def _roomy(scenario: Scenario, start: Tensor) -> Tensor:
    """Whether all vehicles of a world have room where they start, bool [B]."""
    position = start[..., :3]
    i, j = torch.triu_indices(position.shape[1], position.shape[1], 1, device=start.device)
    apart = length(position[:, i] - position[:, j])
    clear = scenario.clearance(position) >= START_CLEARANCE_M
    return clear.all(-1) & (apart >= SEPARATION_M).all(-1)
