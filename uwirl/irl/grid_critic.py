"""A critic on a grid: the least cost to a target as the solution of an eikonal equation, batched over targets.

Where a control's effort only sets the pace, the Hamilton-Jacobi-Bellman equation becomes |grad Phi| = w: Phi is the
least integral of the slowness w over the ways to the target, and its steepest descent is where to go. It knows its
minima globally, which quadratic and network critics do not.

A grid has one, two or three axes in any units, each with a spacing of its own. Lengths are taken in the coordinates as
they are given: |grad Phi|_(R^-1) = w with a diagonal R becomes such an equation once axis i is scaled by sqrt(R_i), and
steepest descent there is the way along R^-1 grad Phi.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.lattice import Lattice
from uwirl.irl.sweeps import BoxSweeps, SquareSweeps


def _unit(x: Tensor) -> Tensor:
    """x / |x| over the last axis; zero stays zero."""
    return x / _length(x.unbind(-1))[..., None].clamp_min(torch.finfo(x.dtype).tiny)


def _upwind_descent(value: Tensor, ratio: Sequence[float]) -> Tensor:
    """Unit vectors [B, *n, d] down the one-sided differences that the Godunov scheme uses; zero at the minimum.

    `ratio` is the least spacing over that of each axis.
    """
    components = []
    for axis in range(1, value.ndim):
        n = value.shape[axis]
        edge = torch.full_like(value.narrow(axis, 0, 1), torch.inf)
        below = torch.cat([edge, value.narrow(axis, 0, n - 1)], axis)
        above = torch.cat([value.narrow(axis, 1, n - 1), edge], axis)
        fall = (value - torch.minimum(below, above)).clamp_min(0.0) * ratio[axis - 1]
        components.append(torch.where(below < above, -fall, fall))
    return _unit(torch.stack(components, -1))


class GridMap(NamedTuple):
    """Least costs to one target a map, and the ways there. Positions outside the grid are clamped to it.

    Attributes:
        value: Phi at the nodes, [B, *n], in the axes' unit times that of slowness.
        descent: unit vectors down Phi's upwind gradient with respect to the coordinates, at the nodes, [B, *n, d].
        target: [B, d].
        rounds: rounds of sweeps each map took, [B].
        lattice: the nodes.
    """

    value: Tensor
    descent: Tensor
    target: Tensor
    rounds: Tensor
    lattice: Lattice

    @classmethod
    def stack(cls, maps: Sequence[GridMap]) -> GridMap:
        """Maps of one grid as one batch."""
        value, descent, target, rounds = (
            torch.cat([getattr(m, name) for m in maps]) for name in ("value", "descent", "target", "rounds")
        )
        return cls(value, descent, target, rounds, maps[0].lattice)

    def replaced(self, index: Tensor, others: GridMap) -> GridMap:
        """With the maps at index [K] replaced by K others of the same grid; these maps stay as they are."""
        value, descent, target, rounds = (
            getattr(self, name).index_put((index,), getattr(others, name))
            for name in ("value", "descent", "target", "rounds")
        )
        return self._replace(value=value, descent=descent, target=target, rounds=rounds)

    def value_at(self, p: Tensor) -> Tensor:
        """Phi at positions p [B, Q, d] by multilinear interpolation, [B, Q]."""
        return self.lattice.interpolate(self.value[..., None], p)[..., 0]

    def descent_direction(self, p: Tensor, step: float = 0.4, steps: int = 3, straight_within: float = 1.5) -> Tensor:
        """Where to go: the unit chord of a few steps of descent, which a single node's gradient does not swing.

        Args:
            p: positions, [B, Q, d]; from outside the grid the chord leads onto it.
            step: length of a step, in the axes' unit.
            steps: number of steps.
            straight_within: distance from the target at which steps go straight to it, in the axes' unit; the
                interpolated gradient there is that of a cone's tip.

        Returns:
            [B, Q, d], zero at the target.
        """
        end = self.lattice.clamped(p)
        for _ in range(steps):
            end = self._step(end, step, straight_within)
        return _unit(end - p)

    def path(self, p: Tensor, step: float = 0.4, max_steps: int = 1000, straight_within: float = 1.5) -> Tensor:
        """Polylines of descent from p [B, Q, d], [B, Q, K, d]: until all are at their target, or for `max_steps`."""
        points = [self.lattice.clamped(p)]
        for _ in range(max_steps):
            if bool((_length((self.target[:, None] - points[-1]).unbind(-1)) <= 1e-3 * step).all()):
                break
            points.append(self._step(points[-1], step, straight_within))
        return torch.stack(points, -2)

    def _step(self, p: Tensor, step: float, straight_within: float) -> Tensor:
        """One step of descent, never beyond the target."""
        ahead = self.target[:, None] - p
        distance = _length(ahead.unbind(-1))[..., None]
        downhill = self.lattice.interpolate(self.descent, p)
        return p + _unit(torch.where(distance < straight_within, ahead, downhill)) * distance.clamp_max(step)


@torch.no_grad()
def solve_eikonal(
    slowness: Tensor,
    origin: Tensor,
    spacing: float | Sequence[float] | Tensor,
    target: Tensor,
    tolerance: float = 1e-6,
    max_rounds: int = 200,
) -> GridMap:
    """Solve |grad Phi| = w, Phi(target) = 0 on regular grids, one target each, by fast sweeping.

    First-order Godunov upwind scheme and Gauss-Seidel sweeps: H. Zhao, "A fast sweeping method for eikonal equations",
    Mathematics of Computation 74, 2005; how a sweep runs: `uwirl.irl.sweeps`.

    Args:
        slowness: w at the nodes, cost a unit of length, [B, *n] with 1 to 3 axes; large but finite inside obstacles,
            for the gradient there to lead out. A wall must be at least two nodes thick: a single node's gradient leads
            out on the cheaper side, and by interpolation draws ways through from the other.
        origin: position of the first node, [d].
        spacing: h, one for all axes or one for each.
        target: [B, d].
        tolerance: a map is done when a round changes it nowhere by more than this share of its largest value.
        max_rounds: a round is 2^d sweeps; about one for each turn of the ways through a right angle is needed.

    Raises:
        ValueError: a slowness that is not positive and finite, a target outside the grid, a grid under 3 nodes a side,
            a spacing that is not positive and finite or not one for each axis.
        ArithmeticError: not converged within `max_rounds`.
    """
    h = _spacings(spacing, slowness.ndim - 1)
    origin, target, along = origin.to(slowness), target.to(slowness), slowness.new_tensor(h)
    _check(slowness, (target - origin) / along)
    w = slowness.movedim(0, -1)
    large = math.sqrt(torch.finfo(slowness.dtype).max) / 4.0  # its square, too, is finite
    lattice = Lattice.of(slowness.shape[1:], origin, along)
    phi = _around_target(slowness, lattice, target, h, large)
    sweeps: SquareSweeps | BoxSweeps
    if len(h) == 2 and h[0] == h[1]:
        sweeps = SquareSweeps(w * h[0], large)
    else:
        sweeps = BoxSweeps(w, h, large)
    nodes = tuple(range(len(h)))
    active = torch.ones(len(slowness), dtype=torch.bool, device=slowness.device)
    rounds = torch.zeros(len(slowness), dtype=torch.long, device=slowness.device)
    while bool(active.any()):
        if int(rounds.max()) == max_rounds:
            raise ArithmeticError(f"the eikonal sweeps did not converge within {max_rounds} rounds")
        swept = sweeps.round(phi)
        change = (phi - swept).amax(nodes)
        # Maps that are done stay as they are, so that a batch equals its singles.
        phi = torch.where(active, swept, phi)
        rounds += active
        active &= ~(change <= tolerance * phi.amax(nodes))
    value = phi.movedim(-1, 0).contiguous()
    return GridMap(value, _upwind_descent(value, [min(h) / x for x in h]), target, rounds, lattice)


def _check(slowness: Tensor, where: Tensor) -> None:
    """Refuse slownesses, and targets that lie at `where` [B, d] in nodes, that `solve_eikonal` cannot serve."""
    sides = slowness.shape[1:]
    if not 1 <= len(sides) <= 3 or min(sides) < 3:
        raise ValueError(f"slowness must be [B, *n] with 1 to 3 axes of at least 3 nodes, got {list(slowness.shape)}")
    if not bool(((slowness > 0.0) & slowness.isfinite()).all()):
        raise ValueError("slowness must be positive and finite everywhere")
    inside = ((where >= 0.0) & (where <= where.new_tensor(sides) - 1.0)).all(-1)
    if not bool(inside.all()):
        raise ValueError(
            f"a target lies outside the grid of {list(sides)} nodes: at {where[~inside][0].tolist()} of them"
        )


def _spacings(spacing: float | Sequence[float] | Tensor, axes: int) -> list[float]:
    """One spacing for each axis."""
    given = torch.as_tensor(spacing, dtype=torch.float64).flatten().tolist()
    h = given * axes if len(given) == 1 else given
    if len(h) != axes or not all(0.0 < x < math.inf for x in h):
        raise ValueError(f"spacing must be positive and finite, one for all {axes} axes or one for each, got {given}")
    return h


def _around_target(slowness: Tensor, lattice: Lattice, target: Tensor, h: Sequence[float], large: float) -> Tensor:
    """Phi [*n, B] within two nodes of the target, and large elsewhere.

    The scheme's error grows with Phi's curvature, which has no bound at a point source: it starts from a disc instead.
    """
    offsets = []
    for axis, n in enumerate(slowness.shape[1:]):
        x = lattice.origin[axis] + h[axis] * torch.arange(n).to(slowness)
        shape = [n if k == axis else 1 for k in range(len(h))]
        offsets.append(x.view(*shape, 1) - target[:, axis])
    distance = _length(offsets)
    nearest = min(h)
    reach = distance if max(h) == nearest else _length([x * (nearest / k) for x, k in zip(offsets, h, strict=True)])
    at_target = lattice.interpolate(slowness[..., None], target[:, None])[:, 0, 0]
    return torch.where(reach <= 2.0 * nearest, distance * (slowness.movedim(0, -1) + at_target) / 2.0, large)


def _length(components: Sequence[Tensor]) -> Tensor:
    """Euclidean length of a vector given by its components, which broadcast."""
    return reduce(torch.add, (x.square() for x in components)).sqrt()
