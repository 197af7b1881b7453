"""A regular grid, and multilinear interpolation on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor


class Lattice(NamedTuple):
    """A regular grid with d axes; what interpolation needs of it is computed once, because it is done at every step.

    Attributes:
        origin: position of the first node, [d].
        spacing: h of each axis, [d].
        last: index of the last node along each axis, [d].
        stride: number of nodes between neighbours along each axis, int64 [d].
        upper: whether a corner of a cell is its upper end along each axis, [2^d, d].
        corner: number of nodes from a cell's first corner to each, int64 [2^d].
    """

    origin: Tensor
    spacing: Tensor
    last: Tensor
    stride: Tensor
    upper: Tensor
    corner: Tensor

    @classmethod
    def of(cls, sides: Sequence[int], origin: Tensor, spacing: Tensor) -> Lattice:
        """The lattice of `sides` nodes along its axes."""
        device = origin.device
        stride = torch.tensor([math.prod(sides[axis + 1 :]) for axis in range(len(sides))], device=device)
        upper = torch.tensor(list(product((False, True), repeat=len(sides))), device=device)
        last = origin.new_tensor([side - 1.0 for side in sides])
        return cls(origin, spacing, last, stride, upper, (upper * stride).sum(-1))

    def clamped(self, p: Tensor) -> Tensor:
        """The positions of the grid nearest to positions p [..., d]."""
        return torch.clamp(p, self.origin, self.origin + self.spacing * self.last)

    def interpolate(self, field: Tensor, p: Tensor) -> Tensor:
        """Multilinear interpolation of a field at the nodes [B, *n, C], clamped to the grid.

        Args:
            field: [B, *n, C].
            p: positions, [B, Q, d].

        Returns:
            [B, Q, C].
        """
        (B, Q, _), C = p.shape, field.shape[-1]
        t = torch.clamp((p - self.origin) / self.spacing, torch.zeros_like(self.last), self.last)
        cell = torch.minimum(t.floor(), self.last - 1.0)
        fraction = (t - cell)[:, :, None]
        index = (cell.long() * self.stride).sum(-1, keepdim=True) + self.corner
        values = field.flatten(1, -2).gather(1, index.view(B, -1, 1).expand(-1, -1, C)).view(B, Q, -1, C)
        weight = torch.where(self.upper, fraction, 1.0 - fraction).prod(-1, keepdim=True)
        # Added one by one: a sum would depend in its last digit on the size of the batch.
        return reduce(torch.add, (weight * values).unbind(2))
