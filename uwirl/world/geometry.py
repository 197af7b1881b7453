"""Rotations in the horizontal plane, wrapped angles and distances, used by all other modules.

psi turns the inertial frame's x axis into the body's surge axis, counter-clockwise seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

import torch
from torch import Tensor


def length(vector: Tensor) -> Tensor:
    """Euclidean length of vectors [..., 2 or more], [...].

    By components: PyTorch's norm over a short last axis is a hundred times slower for a strided one, and depends in its
    last digit on the size of the batch, as its hypot and atan2 do.
    """
    first, *others = vector.unbind(-1)
    return reduce(lambda total, x: torch.addcmul(total, x, x), others, first.square()).sqrt()


def unit(vector: Tensor) -> Tensor:
    """Vectors [..., 2 or more] divided by their length; zero stays zero."""
    return vector / length(vector)[..., None].clamp_min(1e-12)


def to_body(x: Tensor, y: Tensor, psi: Tensor) -> tuple[Tensor, Tensor]:
    """Components of an inertial vector along the axes of a frame turned by psi; arguments broadcast."""
    c, s = torch.cos(psi), torch.sin(psi)
    return torch.addcmul(c * x, s, y), torch.addcmul(c * y, s, x, value=-1.0)


def to_inertial(u: Tensor, v: Tensor, psi: Tensor) -> tuple[Tensor, Tensor]:
    """Inertial components of a vector given along the axes of a frame turned by psi; arguments broadcast."""
    c, s = torch.cos(psi), torch.sin(psi)
    return torch.addcmul(c * u, s, v, value=-1.0), torch.addcmul(s * u, c, v)


def turned_to_body(vector: Tensor, psi: Tensor) -> Tensor:
    """An inertial vector [..., 2 or more] in body axes of yaw psi [...]; components after x, y are unchanged."""
    return torch.cat([torch.stack(to_body(vector[..., 0], vector[..., 1], psi), -1), vector[..., 2:]], -1)


def turned_to_inertial(vector: Tensor, psi: Tensor) -> Tensor:
    """A body vector [..., 2 or more] of yaw psi [...] in the inertial frame; components after u, v are unchanged."""
    return torch.cat([torch.stack(to_inertial(vector[..., 0], vector[..., 1], psi), -1), vector[..., 2:]], -1)


def vector(numbers: Sequence[float], like: Tensor) -> Tensor:
    """Plain numbers as a vector [k] with dtype and device of a tensor: filled there, because a copy waits for a GPU."""
    return torch.stack([like.new_full((), number) for number in numbers])


def left_of(direction: Tensor) -> Tensor:
    """Vectors [..., 2] turned by 90 degrees to the left."""
    return torch.stack([-direction[..., 1], direction[..., 0]], -1)


def unit_vector(angle: Tensor) -> Tensor:
    """Unit vectors [..., 2] at angles [...] from the x axis."""
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
    """Distances between points [..., m, 3] and points [..., n, 3], [..., m, n], m."""
    # The default mode multiplies matrices: its errors are 1e-7, and the diagonal is not zero.
    return torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")


def none_known(mask: Tensor) -> bool:
    """Whether a mask is False everywhere, if that is known at once: False where one would have to wait for the device.

    For work that changes nothing where the mask is False.
    """
    return mask.device.type == "cpu" and not bool(mask.any())
