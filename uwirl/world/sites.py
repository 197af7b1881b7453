"""How the cylinders of random layouts are placed.

kind         cylinders, placed relative to the line from the first vehicle's start to its target
sparse       0-3, most of them near the line
random       3-6, most of them near the line
overlapping  one or two clusters of 2-3 that overlap, near the line
dead_end     6 in a U of 150-240 degrees across the line, open towards the start
ring         24 around the start or the target, closed or with one gap of 1-3 m
moving       1-4 that drift at 0.2-0.5 m/s, timed to cross the line in front of the vehicle
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from uwirl.world.geometry import unit_vector
from uwirl.world.obstacles import Obstacles

# Random numbers that the cylinders of any kind need.
NUMBERS = 37
DEPTH_M = (-16.0, -0.5)
HEADING_RAD = (-2.0, 2.0)
# Assumed speed of the vehicle along its line, for timing drifting cylinders, m/s.
EXPECTED_SPEED = 1.2


class Site:
    """One attempt at n worlds: their random numbers, used in order, and the first vehicle's line to its target.

    Attributes:
        start: eta of all vehicles, [n, M, 4].
        origin: start of the line, [n, 2], m.
        target: end of the line, [2], m.
    """

    def __init__(self, numbers: Tensor, targets: Tensor, half_width_m: float):
        self.numbers = numbers
        self.middle = targets[:, :2].mean(0)
        self.half_width = half_width_m
        vehicles = len(targets)
        parts = self.anywhere(vehicles), self.draw(*DEPTH_M, vehicles, 1), self.draw(*HEADING_RAD, vehicles, 1)
        self.start = torch.cat(parts, -1)
        self.origin, self.target = self.start[:, 0, :2], targets[0, :2]
        self.way = self.target - self.origin
        self.length = torch.linalg.vector_norm(self.way, dim=-1, keepdim=True)

    def draw(self, low: float, high: float, *shape: int) -> Tensor:
        """Uniform in [low, high), [n, *shape]."""
        taken, self.numbers = self.numbers.tensor_split([math.prod(shape)], -1)
        return low + (high - low) * taken.reshape(len(taken), *shape)

    def chance(self, *shape: int) -> Tensor:
        """True with probability 1/2, [n, *shape]."""
        return self.draw(0.0, 1.0, *shape) < 0.5

    def anywhere(self, count: int) -> Tensor:
        """Points in the box about the targets' centroid, [n, count, 2], m."""
        return self.middle + self.draw(-self.half_width, self.half_width, count, 2)

    def near_way(self, low: float, high: float, aside_m: float, count: int) -> Tensor:
        """Points between two fractions of the line, at most `aside_m` to either side, [n, count, 2], m."""
        along = self.way / self.length
        left = torch.stack([-along[:, 1], along[:, 0]], -1)
        fraction, offset = self.draw(low, high, count, 1), self.draw(-aside_m, aside_m, count, 1)
        return self.origin[:, None] + fraction * self.way[:, None] + offset * left[:, None]


def cylinders(
    centre: Tensor, radius: Tensor, present: Tensor | None = None, velocity: Tensor | None = None
) -> Obstacles:
    """Cylinders of radius [n, k], present and at rest by default; `draw_layouts` sets the influence radii later."""
    present = torch.ones_like(radius, dtype=torch.bool) if present is None else present
    return Obstacles(centre, radius, radius, torch.zeros_like(centre) if velocity is None else velocity, present)


def _scattered(fewest: int, most: int, site: Site) -> Obstacles:
    present = torch.arange(most, device=site.numbers.device) < site.draw(fewest, most + 1, 1).floor()
    near = site.draw(0.0, 1.0, most, 1) < 0.7
    centre = torch.where(near, site.near_way(0.15, 0.85, 3.0, most), site.anywhere(most))
    return cylinders(centre, site.draw(0.8, 3.0, most), present)


def _overlapping(site: Site) -> Obstacles:
    first = site.near_way(0.2, 0.8, 2.0, 2)[:, :, None]
    radius = site.draw(1.0, 2.5, 2, 3)
    bearing = site.draw(0.0, 2.0 * math.pi, 2, 1) + torch.nn.functional.pad(site.draw(-0.75, 0.75, 2, 1), (1, 0))
    step = site.draw(0.45, 0.95, 2, 2) * (radius[..., 1:] + radius[..., :-1])
    others = first + (step[..., None] * unit_vector(bearing)).cumsum(-2)
    present = torch.ones_like(radius, dtype=torch.bool)
    present[:, 1] = site.chance(1)
    present[:, :, 2] &= site.chance(2)
    return cylinders(torch.cat([first, others], -2).flatten(1, 2), radius.flatten(1), present.flatten(1))


def _dead_end(site: Site) -> Obstacles:
    count = 6
    arc = torch.minimum(site.draw(3.0, 5.5, 1), 0.3 * site.length)
    span = torch.deg2rad(site.draw(150.0, 240.0, 1))
    ahead = torch.atan2(site.way[:, 1:], site.way[:, :1]) + site.draw(-0.3, 0.3, 1)
    bearing = ahead + span * torch.linspace(-0.5, 0.5, count, dtype=span.dtype, device=span.device)
    # A little more than half their spacing along the arc, so that neighbours overlap.
    radius = 1.12 * arc * span / (count - 1) / 2.0 + site.draw(0.0, 0.1, count)
    return cylinders(site.near_way(0.4, 0.65, 0.0, 1) + arc[..., None] * unit_vector(bearing), radius)


def _ring(site: Site) -> Obstacles:
    count = 24
    around = torch.where(site.chance(1), site.origin, site.target)
    arc = site.draw(3.0, 8.0, 1)
    radius = 1.1 * math.pi / count * arc
    gap = 2.0 * torch.asin((2.0 * radius + site.draw(1.0, 3.0, 1)) / (2.0 * arc))
    # Angle between the last disc and the first.
    opening = torch.where(site.chance(1), torch.full_like(gap, 2.0 * math.pi / count), gap)
    spread = torch.linspace(0.0, 1.0, count, dtype=gap.dtype, device=gap.device)
    bearing = site.draw(0.0, 2.0 * math.pi, 1) + (2.0 * math.pi - opening) * spread
    return cylinders(around[:, None] + arc[..., None] * unit_vector(bearing), radius.expand(-1, count))


def _moving(site: Site) -> Obstacles:
    most = 4
    present = torch.arange(most, device=site.numbers.device) < site.draw(1.0, most + 1, 1).floor()
    crossing = site.near_way(0.2, 0.8, 0.0, most)
    velocity = site.draw(0.2, 0.5, most, 1) * unit_vector(site.draw(0.0, 2.0 * math.pi, most))
    arrival = torch.linalg.vector_norm(crossing - site.origin[:, None], dim=-1, keepdim=True) / EXPECTED_SPEED
    centre = crossing - velocity * (arrival + site.draw(-6.0, 6.0, most, 1))
    return cylinders(centre, site.draw(0.8, 2.5, most), present, velocity)


# Kind: (cylinders at most, how they are drawn).
GENERATORS: dict[str, tuple[int, Callable[[Site], Obstacles]]] = {
    "sparse": (3, partial(_scattered, 0, 3)),
    "random": (6, partial(_scattered, 3, 6)),
    "overlapping": (6, _overlapping),
    "dead_end": (6, _dead_end),
    "ring": (24, _ring),
    "moving": (4, _moving),
}
