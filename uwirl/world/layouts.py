"""Random layouts: where vehicles start and cylinders stand, each world a pure function of its seed.

The kinds are those of `uwirl.world.sites`. A layout that violates a rule of `_acceptable` is drawn again, from the next
step of the world's stream.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.geometry import length
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.regions import separated
from uwirl.world.sites import GENERATORS, NUMBERS, Site, cylinders

KINDS = tuple(GENERATORS)

ATTEMPTS = 1000
# Rules: least horizontal distance from start to target, between vehicles (3-D), and from cylinders.
WAY_M, SEPARATION_M = 12.0, 2.0
START_CLEARANCE_M, MOVING_START_CLEARANCE_M, TARGET_CLEARANCE_M = 0.6, 1.5, 1.2
# A drifting cylinder keeps this distance from every target, during this time.
SWEPT_CLEARANCE_M, SWEPT_TIME_S = 0.8, 120.0
# Position of absent cylinders, far from everything.
FAR_M = 1e4


@dataclass(frozen=True)
class Layouts:
    """Starts and cylinders of N worlds.

    Attributes:
        start: eta, at rest, [N, M, 4].
        obstacles: fields [N, O(, 2)], padded with absent ones.
        kind: index into KINDS, int64 [N].
    """

    start: Tensor
    obstacles: Obstacles
    kind: Tensor

    def feasible(self, targets: Tensor, inflation: float) -> Tensor:
        """Whether every vehicle has a free route to its target, with cylinders at their positions at time 0, bool [N].

        Args:
            targets: [M, 3] or [N, M, 3], m.
            inflation: vehicle radius plus margin, m.
        """
        for_each_vehicle = self.obstacles.each(lambda field: field[:, None])
        return ~separated(for_each_vehicle, inflation, self.start[..., :2], targets[..., :2]).any(-1)


def _acceptable(site: Site, targets: Tensor, obstacles: Obstacles, vehicle_radius: float, clearance_m: float) -> Tensor:
    """Whether all vehicles have room at their starts and targets, and some distance to fly, bool [n]."""
    position = site.start[..., :3]
    way = length(position[..., :2] - targets[:, :2])
    i, j = torch.triu_indices(len(targets), len(targets), 1, device=targets.device)
    apart = length(position[:, i] - position[:, j])
    # The time at which each cylinder comes nearest to each target.
    velocity = obstacles.velocity[:, None]
    offset = obstacles.offset(targets)
    nearest = (offset * velocity).sum(-1) / velocity.square().sum(-1).clamp_min(1e-12)
    drift = velocity * nearest.clamp(0.0, SWEPT_TIME_S)[..., None]
    swept = length(offset - drift) - obstacles.radius[:, None] - vehicle_radius
    return (
        (way >= WAY_M).all(-1)
        & (apart >= SEPARATION_M).all(-1)
        & (obstacles.clearance(position, vehicle_radius) >= clearance_m).flatten(1).all(-1)
        & (obstacles.clearance(targets, vehicle_radius) >= TARGET_CLEARANCE_M).flatten(1).all(-1)
        & ((swept >= SWEPT_CLEARANCE_M) | ~obstacles.present[:, None]).flatten(1).all(-1)
    )


def draw_layouts(
    streams: RandomStreams,
    kinds: Sequence[str],
    targets: Tensor,
    half_width_m: float = 30.0,
    vehicle_radius: float = 0.3,
    influence_gap_m: float = 4.0,
) -> Layouts:
    """One random layout for each world; world i of a seed has kind kinds[i % len(kinds)].

    Args:
        streams: N worlds.
        kinds: names among KINDS.
        targets: target of each vehicle, [M, 3], m; layouts have the same dtype.
        half_width_m: vehicles start in a square of this half width about the targets' centroid.
        vehicle_radius: m.
        influence_gap_m: influence radius less physical radius.

    Raises:
        ValueError: a kind is unknown, or none is given.
        RuntimeError: no attempt was acceptable for some world, because the targets leave no room.
    """
    if not kinds or not set(kinds) <= set(KINDS):
        raise ValueError(f"kinds: expected some of {', '.join(KINDS)}, got {', '.join(kinds) or 'none'}")
    count, device, ends = len(streams.world), streams.world.device, targets.to(torch.float64)
    kind = torch.tensor([KINDS.index(name) for name in kinds], device=device)[streams.world % len(kinds)]
    start = ends.new_empty(count, len(ends), 4)
    slots = max(GENERATORS[name][0] for name in kinds)
    none = ends.new_zeros(count, slots)
    obstacles = cylinders(ends.new_zeros(count, slots, 2), none, none.bool())
    for name in dict.fromkeys(kinds):
        most, place = GENERATORS[name]
        clearance = MOVING_START_CLEARANCE_M if name == "moving" else START_CLEARANCE_M
        rows = (kind == KINDS.index(name)).nonzero()[:, 0]
        for attempt in range(ATTEMPTS):
            if not len(rows):
                break
            numbers = streams.select(rows).uniform(Stream.LAYOUT, attempt, NUMBERS + 4 * len(ends))
            site = Site(numbers, ends, half_width_m)
            drawn = place(site)
            good = _acceptable(site, ends, drawn, vehicle_radius, clearance)
            start[rows[good]] = site.start[good]
            for field, new in zip(obstacles, drawn, strict=True):
                field[rows[good], :most] = new[good]
            rows = rows[~good]
        if len(rows):
            raise RuntimeError(f"no acceptable layout of kind {name} in {ATTEMPTS} attempts for world {int(rows[0])}")
    return Layouts(start.to(targets.dtype), _padded(obstacles, influence_gap_m, targets.dtype), kind)


def _padded(drawn: Obstacles, influence_gap_m: float, dtype: torch.dtype) -> Obstacles:
    """Obstacles with influence radii; absent cylinders are far away, so that ignoring the mask does no harm."""
    present = drawn.present
    return Obstacles(
        torch.where(present[..., None], drawn.centre, FAR_M).to(dtype),
        torch.where(present, drawn.radius, 1.0).to(dtype),
        torch.where(present, drawn.radius + influence_gap_m, 2.0).to(dtype),
        torch.where(present[..., None], drawn.velocity, 0.0).to(dtype),
        present,
    )
