"""Regularised and bounded linear least squares, batched over independent learners."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class Regularisation(NamedTuple):
    """Quadratic penalties in units where every regressor has unit mean square, so that they need no tuning to scale.

    Attributes:
        ridge: on every unknown, towards zero.
        prior: on the actor's weights, towards the present policy.
    """

    ridge: float = 0.0
    prior: float = 0.0


class NormalEquations(NamedTuple):
    """min_x x'Nx/2 - b'x after scaling to a unit diagonal; the unknowns are x / scale.

    Attributes:
        N: [..., n, n].
        b: [..., n].
        scale: root mean square of each regressor, [..., n].
    """

    N: Tensor
    b: Tensor
    scale: Tensor

    @classmethod
    def scaled(cls, N: Tensor, b: Tensor) -> NormalEquations:
        """From unscaled mean products N = theta'theta / S, b = theta'y / S."""
        scale = N.diagonal(dim1=-2, dim2=-1).clamp_min(0.0).sqrt() + 1e-12
        return cls(N / scale[..., :, None] / scale[..., None, :], b / scale, scale)

    def regularised(self, penalty: Tensor, centre: Tensor) -> NormalEquations:
        """With penalty_i (x_i - centre_i scale_i)^2 / 2 added; penalty [n], centre [..., n] in unscaled units."""
        return NormalEquations(self.N + torch.diag(penalty), self.b + penalty * centre * self.scale, self.scale)

    def solve(self, lower: Tensor | None = None, upper: Tensor | None = None) -> Tensor:
        """The minimiser in unscaled units, [..., n], within bounds [n] where they are given."""
        if lower is None or upper is None:
            return torch.linalg.solve(self.N, self.b) / self.scale
        return bounded_quadratic(self.N, self.b, lower * self.scale, upper * self.scale) / self.scale


def bounded_quadratic(N: Tensor, b: Tensor, lower: Tensor, upper: Tensor, max_rounds: int = 500) -> Tensor:
    """argmin x'Nx/2 - b'x over lower <= x <= upper by block principal pivoting, batched.

    Every round frees or fixes all variables that violate the optimality conditions; where that stops reducing their
    number, only the last violating one is exchanged, which cannot cycle for positive definite N (Judice and Pires,
    "A block principal pivoting algorithm for large-scale strictly monotone linear complementarity problems", 1994).

    Args:
        N: positive definite, [..., n, n].
        b: [..., n].
        lower, upper: [..., n], infinite where there is no bound.

    Returns:
        [..., n].

    Raises:
        RuntimeError: no solution within max_rounds, which means N is not positive definite.
    """
    n = b.shape[-1]
    shape = b.shape
    N, b = N.reshape(-1, n, n), b.reshape(-1, n)
    lower, upper = lower.expand(shape).reshape(-1, n), upper.expand(shape).reshape(-1, n)
    side = torch.zeros_like(b, dtype=torch.int8)  # -1 at the lower bound, +1 at the upper, 0 free
    fewest = torch.full((b.shape[0],), n + 1, device=b.device)
    patience = torch.full_like(fewest, 3)
    identity = torch.eye(n, dtype=N.dtype, device=N.device)
    slack = 1e-12
    for _ in range(max_rounds):
        free = side == 0
        fixed_value = torch.where(side < 0, lower, torch.where(side > 0, upper, torch.zeros_like(b)))
        system = torch.where(free[..., :, None] & free[..., None, :], N, identity)
        rhs = torch.where(free, b - (N @ fixed_value[..., None])[..., 0], fixed_value)
        x = torch.linalg.solve(system, rhs)
        gradient = (N @ x[..., None])[..., 0] - b
        below, above = free & (x < lower - slack), free & (x > upper + slack)
        release = ((side < 0) & (gradient < -slack)) | ((side > 0) & (gradient > slack))
        violating = below | above | release
        count = violating.sum(-1)
        if not bool(count.any()):
            return x.clamp(lower, upper).reshape(shape)
        improved = count < fewest
        fewest = torch.minimum(fewest, count)
        patience = torch.where(improved, 3, patience - 1)
        last = torch.arange(n, device=b.device) == (n - 1 - violating.flip(-1).int().argmax(-1))[:, None]
        exchange = violating & ((patience >= 0)[:, None] | last)
        target = below.to(torch.int8).neg() + above.to(torch.int8)
        side = torch.where(exchange, target, side)
    raise RuntimeError("bounded least squares did not terminate: its normal matrix is not positive definite")
