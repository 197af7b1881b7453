"""Regularised and bounded linear least squares, batched over independent learners."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


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

    def residual(self, x: Tensor, power: Tensor) -> Tensor:
        """Root mean square of theta x - y over that of y, for x in unscaled units [..., n] and mean y^2 [...]."""
        x = x * self.scale
        square = power - 2.0 * (self.b * x).sum(-1) + (x * (self.N @ x[..., None])[..., 0]).sum(-1)
        return (square.clamp_min(0.0) / power).sqrt()

    def condition(self) -> Tensor:
        """Condition number of N, [...]; at most the inverse of the rounding error."""
        least, most = torch.linalg.eigvalsh(self.N.nan_to_num()).aminmax(dim=-1)
        return most / torch.maximum(least, torch.finfo(most.dtype).eps * most)

    def solve(self, lower: Tensor | None = None, upper: Tensor | None = None) -> Tensor:
        """The minimiser in unscaled units, [..., n], within bounds [n] where they are given."""
        if lower is None or upper is None:
            return torch.linalg.solve(self.N, self.b) / self.scale
        return bounded_quadratic(self.N, self.b, lower * self.scale, upper * self.scale) / self.scale


def bounded_quadratic(N: Tensor, b: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """argmin x'Nx/2 - b'x over lower <= x <= upper by a primal active set, batched.

    From a feasible point every round goes to the minimum over the free variables, or as far as the first bound that is
    met, which then holds; at a minimum, the bound that opposes it most is let go. The objective falls every round (as
    in BVLS: P. B. Stark and R. L. Parker, "Bounded-variable least squares", Computational Statistics 10, 1995).

    Args:
        N: positive definite, [..., n, n].
        b: [..., n].
        lower, upper: [..., n], infinite where there is no bound.

    Returns:
        [..., n].

    Raises:
        ArithmeticError: no solution, which means that N is not positive definite or not finite.
    """
    shape, n = b.shape, b.shape[-1]
    N, b = N.reshape(-1, n, n), b.reshape(-1, n)
    lower, upper = lower.expand(shape).reshape(-1, n), upper.expand(shape).reshape(-1, n)
    x = torch.zeros_like(b).clamp(lower, upper)
    side = torch.zeros_like(b)  # -1 held at the lower bound, +1 at the upper, 0 free
    identity = torch.eye(n, dtype=N.dtype, device=N.device)
    rows = torch.arange(len(b), device=b.device)
    for _ in range(20 * n):
        free = side == 0
        system = torch.where(free[:, :, None] & free[:, None, :], N, identity)
        gradient = (N @ x[..., None])[..., 0] - b
        direction = torch.where(free, torch.linalg.solve(system, torch.where(free, -gradient, 0.0)), 0.0)
        bound = torch.where(direction > 0, upper, lower)
        room = torch.where(direction != 0, (bound - x) / direction, torch.inf)
        reach, first = room.min(-1)
        blocked = reach < 1.0
        x = torch.where(blocked[:, None], x + reach[:, None] * direction, x + direction)
        x = x.clamp(lower, upper)
        hit = rows[blocked], first[blocked]
        x[hit] = bound[hit]
        side[hit] = direction[hit].sign()
        gradient = (N @ x[..., None])[..., 0] - b
        rounding = 1e-11 * ((N.abs() @ x.abs()[..., None])[..., 0] + b.abs())
        # Positive where the objective would fall if the bound were let go.
        gain = torch.where(side != 0, side * gradient - rounding, 0.0).clamp_min(0.0)
        most, which = gain.max(-1)
        release = ~blocked & (most > 0)
        if not bool((blocked | release).any()):
            break
        side[rows[release], which[release]] = 0.0
    if bool((blocked | release).any()) or not bool(torch.isfinite(x).all()):
        raise ArithmeticError("bounded least squares found no solution: its normal matrix is not positive definite")
    return x.reshape(shape)
