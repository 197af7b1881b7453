"""Optimal flights on a learned model: direct collocation, solved by sequential quadratic programming in batched torch.

    minimise    J(x, effort)
    subject to  x_k+1 - x_k = dt/2 (f(x_k, effort_k) + f(x_k+1, effort_k)),   x_0 given,   |tau| <= tau_max

by the implicit trapezoid with held control (Betts, Practical Methods for Optimal Control and Estimation Using Nonlinear
Programming, 2010, ch. 4). Nodes need not satisfy the dynamics before the end, so dynamics, Jacobians and costs of all
nodes, guesses and worlds are single calls; only the Riccati recursion goes through time. Its gains fly the plan.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.riccati import LinearQuadratic, Step, solve
from uwirl.motion.flight_cost import FlightCost
from uwirl.motion.vehicle_model import VehicleModel

# Lengths of a step that are compared.
SHARES = (1.0, 0.5, 0.2, 0.05)
# Weight of the defects in the merit function, relative to the largest costate.
MERIT = 1.5
# Regularisation of the control's Hessian, relative to it: where it begins, and beyond which nothing improves.
LEAST_DAMPING, MOST_DAMPING = 0.03, 1e5
# A flight is done when its merit has improved by less than this share in two iterations.
TOLERANCE = 1e-4


class Flights(NamedTuple):
    """Flights on nodes dt apart.

    Attributes:
        x: eta and nu through the water, [N + 1, K, 8].
        effort: tau - trim, held from node to node, [N, K, 4].
        gain: effort = effort_k + gain_k (x - x_k), [N, K, 4, 8].
        J: [K].
        defect: largest violation of the dynamics, [K].
    """

    x: Tensor
    effort: Tensor
    gain: Tensor
    J: Tensor
    defect: Tensor

    @classmethod
    def joined(cls, parts: list[Flights]) -> Flights:
        """Flights of several batches as one."""
        return cls(*(torch.cat(some, 1 if some[0].ndim > 1 else 0) for some in zip(*parts, strict=True)))

    def select(self, rows: Tensor) -> Flights:
        """Some of the flights, by their numbers."""
        return Flights(self.x[:, rows], self.effort[:, rows], self.gain[:, rows], self.J[rows], self.defect[rows])


@dataclass(frozen=True)
class FlightProblem:
    """K flights to plan.

    Attributes:
        model: of the vehicles, [K].
        cost: of the flights, [K].
        tau_max: thruster limits, [4].
    """

    model: VehicleModel
    cost: FlightCost
    tau_max: Tensor

    def select(self, rows: Tensor) -> FlightProblem:
        """Some of the problems, by their numbers."""
        return FlightProblem(self.model.select(rows), self.cost.select(rows), self.tau_max)

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        """Smallest and largest effort, [K, 4]."""
        return -self.tau_max - self.model.trim, self.tau_max - self.model.trim

    def defects(self, x: Tensor, effort: Tensor) -> Tensor:
        """x_k + dt/2 (f_k + f_k+1) - x_k+1, [N, ..., K, 8]; zero where the dynamics hold."""
        half = 0.5 * self.cost.dt
        ahead = self.model.rate(x[1:], effort)
        return x[:-1] - x[1:] + half * (self.model.rate(x[:-1], effort) + ahead)

    def quadratic(self, x: Tensor, effort: Tensor, damping: Tensor) -> LinearQuadratic:
        """The linear-quadratic problem about flights, with the control's Hessian scaled by 1 + damping [K]."""
        half = 0.5 * self.cost.dt
        F = self.model.jacobian(x)
        eye = torch.eye(8, dtype=x.dtype, device=x.device)
        push = x.new_zeros(*effort.shape[:-1], 8, 4)
        push[..., 4:, :] = 2.0 * half * self.model.inverse_inertia
        right = torch.cat([eye + half * F[:-1], push, self.defects(x, effort)[..., None]], -1)
        dynamics = torch.linalg.solve(eye - half * F[1:], right)
        g, H = self.cost.expanded(x)
        R = 2.0 * self.cost.dt * self.cost.cost.R.to(x)
        cost = x.new_zeros(*effort.shape[:-1], 12, 13)
        cost[..., :8, :8], cost[..., :8, 12] = H[:-1], g[:-1]
        cost[..., 8:, 8:12] = torch.diag_embed(R * (1.0 + damping[:, None]))
        cost[..., 8:, 12] = R * effort
        low, high = self.bounds
        final = torch.cat([H[-1], g[-1][..., None]], -1)
        return LinearQuadratic(dynamics, cost, final, low - effort, high - effort)

    def merit(self, x: Tensor, effort: Tensor, price: Tensor) -> tuple[Tensor, Tensor]:
        """J plus priced defects [..., K], and J alone; price [K, 8]."""
        J = self.cost.total(x, effort)
        return J + (self.defects(x, effort).abs() * price).sum((0, -1)), J


def optimise(problem: FlightProblem, start: Tensor, x: Tensor, effort: Tensor, iterations: int) -> Flights:
    """Improve flights.

    Args:
        problem: K flights.
        start: x_0, [K, 8].
        x: guesses, [N + 1, K, 8].
        effort: of them, [N, K, 4].
        iterations: at most so many.
    """
    x, effort = x.clone(), effort.clamp(*problem.bounds)
    K = len(start)
    damping, calm = start.new_zeros(K), torch.zeros(K, dtype=torch.long, device=start.device)
    gain = x.new_zeros(*effort.shape, 8)
    for _ in range(iterations):
        rows = ((calm < 2) & (damping < MOST_DAMPING)).nonzero()[:, 0]
        if not len(rows):
            break
        some = problem if len(rows) == K else problem.select(rows)
        now = x[:, rows], effort[:, rows]
        step = solve(some.quadratic(*now, damping[rows]), start[rows] - now[0][0])
        better, (x[:, rows], effort[:, rows]), share, progress = _searched(some, now, step)
        gain[:, rows] = step.gain
        old = damping[rows]
        raised = old.clamp_min(LEAST_DAMPING) * 8.0
        lowered = torch.where(share >= 0.5, old / 4.0, old * 2.0)
        damping[rows] = torch.where(better, torch.where(lowered < 1e-3, 0.0, lowered), raised)
        calm[rows] = torch.where(better & (progress < TOLERANCE), calm[rows] + 1, 0)
    defect = problem.defects(x, effort).abs().amax((0, -1))
    return Flights(x, effort, gain, problem.cost.total(x, effort), defect)


def _searched(
    problem: FlightProblem, now: tuple[Tensor, Tensor], step: Step
) -> tuple[Tensor, tuple[Tensor, Tensor], Tensor, Tensor]:
    """The best of several lengths of a step.

    Returns:
        Whether the merit falls [K], the flights then, the share of the step [K], and the relative progress [K].
    """
    x, effort = now
    price = MERIT * step.costate[1:].abs()
    before, _ = problem.merit(x, effort, price)
    before = before + ((step.dx[0]).abs() * MERIT * step.costate[0].abs()).sum(-1)
    share = x.new_tensor(SHARES)[:, None, None]
    xs = x[:, None] + share * step.dx[:, None]
    efforts = (effort[:, None] + share * step.du[:, None]).clamp(*problem.bounds)
    after, _ = problem.merit(xs, efforts, price[:, None])
    after = after + (1.0 - share[..., 0]) * ((step.dx[0]).abs() * MERIT * step.costate[0].abs()).sum(-1)
    merit, which = torch.where(after.isfinite(), after, torch.inf).min(0)
    better = merit < before
    taken = torch.where(better, share[which, 0, 0], 0.0)
    columns = torch.arange(x.shape[1], device=x.device)
    mask = better[:, None]
    x = torch.where(mask, xs[:, which, columns], x)
    effort = torch.where(mask, efforts[:, which, columns], effort)
    return better, (x, effort), taken, (before - merit) / before.abs().clamp_min(1e-9)
