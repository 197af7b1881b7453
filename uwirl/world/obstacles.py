"""Obstacles: vertical cylinders, standing or drifting (Assumption 1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import length


class Obstacles(NamedTuple):
    """O cylinders, the same in all worlds or different in each; unused places of a world have `present` False.

    Attributes:
        centre: of the axis at time 0, [..., O, 2], m.
        radius: physical radius rho_m, [..., O], m.
        influence: radius rho_o within which the avoidance term of the cost counts, [..., O], m.
        velocity: [..., O, 2], m/s.
        present: [..., O].
    """

    centre: Tensor
    radius: Tensor
    influence: Tensor
    velocity: Tensor
    present: Tensor

    @property
    def number(self) -> int:
        """Number of cylinders O, present or not."""
        return self.radius.shape[-1]

    def each(self, change: Callable[[Tensor], Tensor]) -> Obstacles:
        """Obstacles with the same function applied to every field."""
        return Obstacles(*(change(field) for field in self))

    def worlds(self, index: Tensor) -> Obstacles:
        """The obstacles of some worlds of a batch, by their numbers [K]; unchanged if all worlds share them."""
        return self if self.radius.ndim == 1 else self.each(lambda field: field[index])

    def offset(self, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """From each axis to each vehicle, horizontally, [..., M, O, 2], m.

        Args:
            position: [..., M, 3], or [..., M, 2] without depth, m.
            time: s, a number or [...] like the batch of positions.
        """
        time = torch.as_tensor(time, dtype=position.dtype, device=position.device)
        centre = self.centre + self.velocity * time[..., None, None]
        return position[..., :, None, :2] - centre[..., None, :, :]

    def distance(self, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """l: from axis to vehicle, [..., M, O], m; infinite where there is no obstacle. Arguments: see `offset`."""
        l = length(self.offset(position, time))
        return torch.where(self.present[..., None, :], l, torch.inf)

    def clearance(self, position: Tensor, vehicle_radius: float, time: Tensor | float = 0.0) -> Tensor:
        """Distance between hull and cylinder, [..., M, O], m: negative in contact, infinite where there is no obstacle.

        Args:
            position: [..., M, 3], m.
            vehicle_radius: m.
            time: s, a number or [...] like the batch of positions.
        """
        return self.distance(position, time) - self.radius[..., None, :] - vehicle_radius


def no_obstacles(dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Obstacles:
    """Free water, O = 0."""
    zero = torch.zeros(0, dtype=dtype, device=device)
    return Obstacles(zero.view(0, 2), zero, zero, zero.view(0, 2), zero.bool())


def contacts(clearance: Tensor) -> Tensor:
    """Number of contact intervals: times at which a clearance over time [n + 1, ...] turns negative, [...]."""
    touching = clearance < 0.0
    return (touching[1:] & ~touching[:-1]).sum(0) + touching[0]
