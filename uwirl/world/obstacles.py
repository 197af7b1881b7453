"""Obstacles: vertical cylinders, standing or drifting (Assumption 1)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Obstacles:
    """O cylinders, the same in every world or other ones in each; worlds with fewer pad with `present` False.

    Attributes:
        centre: of the axis at time 0, [..., O, 2], m.
        radius: physical radius rho_m, [..., O], m.
        influence: radius rho_o of the avoidance term, [..., O], m.
        velocity: [..., O, 2], m/s.
        present: [..., O].
    """

    centre: Tensor
    radius: Tensor
    influence: Tensor
    velocity: Tensor
    present: Tensor

    @property
    def count(self) -> int:
        """O."""
        return self.radius.shape[-1]

    def offset(self, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """From each axis to each vehicle, horizontally, [..., M, O, 2], m.

        Args:
            position: [..., M, 3], m.
            time: s, a number or [...] like the batch of positions.
        """
        time = torch.as_tensor(time, dtype=position.dtype, device=position.device)
        centre = self.centre + self.velocity * time[..., None, None]
        return position[..., :, None, :2] - centre[..., None, :, :]

    def clearance(self, position: Tensor, vehicle_radius: float, time: Tensor | float = 0.0) -> Tensor:
        """Gap between hull and cylinder, [..., M, O], m: negative in contact, infinite where there is no obstacle.

        Args:
            position: [..., M, 3], m.
            vehicle_radius: m.
            time: s, a number or [...] like the batch of positions.
        """
        gap = torch.linalg.vector_norm(self.offset(position, time), dim=-1) - self.radius[..., None, :] - vehicle_radius
        return torch.where(self.present[..., None, :], gap, torch.inf)

    def avoidance(self, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """E_O = sum of max(0, 1/l - 1/rho_o)^2 over the obstacles, [..., M], with l the distance to the axis.

        The printed (34) squares without the max, so that it grows again beyond rho_o and draws vehicles to the ring.
        """
        l = torch.linalg.vector_norm(self.offset(position, time), dim=-1)
        near = (1.0 / l - 1.0 / self.influence[..., None, :]).clamp_min(0.0)
        return torch.where(self.present[..., None, :], near.square(), 0.0).sum(-1)


def no_obstacles(dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Obstacles:
    """Free water, O = 0."""
    zero = torch.zeros(0, dtype=dtype, device=device)
    return Obstacles(zero.view(0, 2), zero, zero, zero.view(0, 2), zero.bool())


def contacts(clearance: Tensor) -> Tensor:
    """Number of contact intervals: times at which a clearance over time [n + 1, ...] turns negative, [...]."""
    touching = clearance < 0.0
    return (touching[1:] & ~touching[:-1]).sum(0) + touching[0]
