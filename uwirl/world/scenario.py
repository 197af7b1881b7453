"""A relay problem: positions of nodes, vehicles, sensors and obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from uwirl.world.current import Current
from uwirl.world.navigation import Navigation
from uwirl.world.obstacles import Obstacles, no_obstacles
from uwirl.world.random import RandomStreams, Stream


@dataclass(frozen=True)
class Scenario:
    """One relay problem. Worlds of a batch share it; only starts, obstacles and current may differ.

    Attributes:
        source: [3], m.
        destination: [3], m.
        start: eta of each vehicle in chain order from the source, [M, 4] or [B, M, 4].
        sensors: [N, 3], m.
        obstacles: vertical cylinders.
        current: ocean current.
        depth: water depth, m: a vehicle's centre stays in -depth <= z <= 0.
        hearing_range: largest distance at which a message is received, m.
        detection_range: horizontal distance from hull to hull at which a vehicle detects an obstacle, m (Definition 1);
            infinite if all obstacles are known.
        vehicle_radius: m.
        dt: integration step, s.
        message_period: time between messages, s; fading in flight is evaluated when a message is sent.
        duration: length of a mission, s.
        navigation: navigation errors of the vehicles; none by default.
        streaming: whether sensors answer every message in flight with SNR readings.
    """

    source: Tensor
    destination: Tensor
    start: Tensor
    sensors: Tensor
    obstacles: Obstacles = field(default_factory=no_obstacles)
    current: Current = field(default_factory=Current.still)
    depth: float = 20.0
    hearing_range: float = math.inf
    detection_range: float = math.inf
    vehicle_radius: float = 0.3
    dt: float = 0.05
    message_period: float = 0.5
    duration: float = 80.0
    navigation: Navigation = field(default_factory=Navigation)
    streaming: bool = False

    @classmethod
    def between(
        cls,
        source: Sequence[float],
        destination: Sequence[float],
        starts: Sequence[Sequence[float]],
        sensors: int = 16,
        seed: int = 0,
        **others: Any,
    ) -> Scenario:
        """A scenario from plain numbers.

        Args:
            source, destination: x, y, z of the nodes, m.
            starts: x, y, z (m) and psi (rad) of each vehicle.
            sensors: number of sensors, at random positions.
            seed: for these positions.
            others: any other attribute.
        """
        first, last = (torch.tensor(list(place), dtype=torch.float64) for place in (source, destination))
        start = torch.tensor([list(eta) for eta in starts], dtype=torch.float64)
        return cls(first, last, start, spread_sensors(sensors, seed, source, destination, torch.float64), **others)

    @property
    def vehicles(self) -> int:
        """Number of vehicles M."""
        return self.start.shape[-2]

    def clearance(self, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """Smallest gap between each vehicle at [..., M, 3] and any obstacle, [..., M], m; infinite in free water."""
        if self.obstacles.number == 0:
            return torch.full(position.shape[:-1], torch.inf, dtype=position.dtype, device=position.device)
        return self.obstacles.clearance(position, self.vehicle_radius, time).amin(-1)

    def worlds(self, index: Tensor) -> Scenario:
        """The scenario of some worlds of a batch, by their numbers [K]."""
        start = self.start[index] if self.start.ndim == 3 else self.start
        return replace(self, start=start, obstacles=self.obstacles.worlds(index), current=self.current.worlds(index))

    @property
    def steps(self) -> int:
        """Integration steps in a mission."""
        return round(self.duration / self.dt)


def spread_sensors(
    count: int, seed: int, source: Sequence[float], destination: Sequence[float], dtype: torch.dtype
) -> Tensor:
    """Uniformly distributed sensors, as a function of the seed, in the box around source and destination.

    The box is larger by a quarter of their distance horizontally, and by 4 m up and down.

    Returns:
        [count, 3], m.
    """
    ends = torch.tensor([list(source), list(destination)], dtype=torch.float64)
    widening = torch.full((3,), float(0.25 * torch.linalg.vector_norm(ends[0] - ends[1])), dtype=torch.float64)
    widening[2] = 4.0
    low, high = ends.amin(0) - widening, ends.amax(0) + widening
    draws = RandomStreams.worlds(seed, 1).uniform(Stream.SENSOR_PLACEMENT, 0, 3 * count)
    return (low + (high - low) * draws.view(count, 3)).to(dtype)
