"""Rotations in the horizontal plane, angles that wrap, and distances: the geometry that everything else shares.

psi turns the inertial frame's x axis into the body's surge axis, counter-clockwise seen from above.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def to_body(x: Tensor, y: Tensor, psi: Tensor) -> tuple[Tensor, Tensor]:
    """Components along the axes of a frame turned by psi, of a vector in the inertial frame; all broadcast."""
    c, s = torch.cos(psi), torch.sin(psi)
    return c * x + s * y, c * y - s * x


def to_inertial(u: Tensor, v: Tensor, psi: Tensor) -> tuple[Tensor, Tensor]:
    """Components in the inertial frame, of a vector along the axes of a frame turned by psi; all broadcast."""
    c, s = torch.cos(psi), torch.sin(psi)
    return c * u - s * v, s * u + c * v


def turned_to_body(vector: Tensor, psi: Tensor) -> Tensor:
    """A vector [..., 2 or more] of the inertial frame in body axes of yaw psi [...]; what comes after x, y stays."""
    return torch.cat([torch.stack(to_body(vector[..., 0], vector[..., 1], psi), -1), vector[..., 2:]], -1)


def turned_to_inertial(vector: Tensor, psi: Tensor) -> Tensor:
    """A vector [..., 2 or more] along body axes of yaw psi [...] in the inertial frame; what comes after u, v stays."""
    return torch.cat([torch.stack(to_inertial(vector[..., 0], vector[..., 1], psi), -1), vector[..., 2:]], -1)


def left_of(direction: Tensor) -> Tensor:
    """[..., 2] turned by 90 degrees to the left."""
    return torch.stack([-direction[..., 1], direction[..., 0]], -1)


def unit_vector(angle: Tensor) -> Tensor:
    """[..., 2] at angles [...]."""
    return torch.stack([torch.cos(angle), torch.sin(angle)], -1)


def wrapped(angle: Tensor, period: float = 2.0 * math.pi) -> Tensor:
    """An angle in [-period / 2, period / 2)."""
    return torch.remainder(angle + period / 2.0, period) - period / 2.0


def rotation_matrix(psi: Tensor) -> Tensor:
    """J(psi) [..., 4, 4] of a yaw angle [...], which turns nu into the time derivative of eta."""
    c, s, zero, one = torch.cos(psi), torch.sin(psi), torch.zeros_like(psi), torch.ones_like(psi)
    rows = [[c, -s, zero, zero], [s, c, zero, zero], [zero, zero, one, zero], [zero, zero, zero, one]]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def distances(a: Tensor, b: Tensor) -> Tensor:
    """Between points [..., m, 3] and [..., n, 3]: [..., m, n], m."""
    # The default multiplies matrices, which is wrong by 1e-7 and has no zero diagonal.
    return torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")
