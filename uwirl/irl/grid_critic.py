"""A critic on a grid: the least cost to a target as the solution of an eikonal equation, batched over targets.

Where a control's effort only sets the pace, the Hamilton-Jacobi-Bellman equation becomes |grad Phi| = w: Phi is the
least integral of the slowness w over the ways to the target, and its steepest descent is where to go. It knows its
minima globally, which quadratic and network critics do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor


def _unit(x: Tensor) -> Tensor:
    """x / |x| over the last axis; zero stays zero."""
    return x / x.norm(dim=-1, keepdim=True).clamp_min(torch.finfo(x.dtype).tiny)


def _interpolate(field: Tensor, p: Tensor, origin: Tensor, spacing: float) -> Tensor:
    """Multilinear interpolation of field [B, *n, C] at p [B, Q, d], clamped to the grid; [B, Q, C]."""
    nodes = torch.tensor(field.shape[1:-1], device=p.device)
    strides = torch.tensor(
        [math.prod(field.shape[axis + 1 : -1]) for axis in range(1, field.ndim - 1)], device=p.device
    )
    t = torch.minimum(((p - origin) / spacing).clamp_min(0.0), nodes - 1)
    cell = torch.minimum(t.long(), nodes - 2)
    fraction = t - cell
    values = field.flatten(1, -2)
    total = torch.zeros_like(values[:, :1])
    for corner in product((0, 1), repeat=p.shape[-1]):
        upper = torch.tensor(corner, device=p.device)
        weight = torch.where(upper > 0, fraction, 1.0 - fraction).prod(-1, keepdim=True)
        index = ((cell + upper) * strides).sum(-1, keepdim=True)
        total = total + weight * values.gather(1, index.expand(-1, -1, field.shape[-1]))
    return total


def _upwind_descent(value: Tensor) -> Tensor:
    """Unit vectors [B, *n, d] down the one-sided differences that the Godunov scheme uses; zero at the minimum."""
    components = []
    for axis in range(1, value.ndim):
        n = value.shape[axis]
        edge = torch.full_like(value.narrow(axis, 0, 1), torch.inf)
        below = torch.cat([edge, value.narrow(axis, 0, n - 1)], axis)
        above = torch.cat([value.narrow(axis, 1, n - 1), edge], axis)
        fall = (value - torch.minimum(below, above)).clamp_min(0.0)
        components.append(torch.where(below < above, -fall, fall))
    return _unit(torch.stack(components, -1))


@dataclass(frozen=True)
class GridMap:
    """Least costs to one target a map, and the ways there. Positions outside the grid are clamped to it.

    Attributes:
        value: Phi at the nodes, [B, nx, ny], in m times the unit of slowness.
        descent: unit vectors down Phi's upwind gradient at the nodes, [B, nx, ny, 2].
        target: m, [B, 2].
        origin: position of node (0, 0), m, [2].
        spacing: h, m.
        rounds: rounds of sweeps each map took, [B].
    """

    value: Tensor
    descent: Tensor
    target: Tensor
    origin: Tensor
    spacing: float
    rounds: Tensor

    @classmethod
    def stack(cls, maps: Sequence[GridMap]) -> GridMap:
        """Maps of one grid as one batch."""
        value, descent, target, rounds = (
            torch.cat([getattr(m, name) for m in maps]) for name in ("value", "descent", "target", "rounds")
        )
        return cls(value, descent, target, maps[0].origin, maps[0].spacing, rounds)

    def put(self, index: Tensor, others: GridMap) -> None:
        """Replace the maps at index [K] by K others of the same grid, in place."""
        for name in ("value", "descent", "target", "rounds"):
            getattr(self, name)[index] = getattr(others, name)

    def value_at(self, p: Tensor) -> Tensor:
        """Phi at positions p [B, Q, 2] by bilinear interpolation, [B, Q]."""
        return _interpolate(self.value[..., None], p, self.origin, self.spacing)[..., 0]

    def descent_direction(self, p: Tensor, step: float = 0.4, steps: int = 3, straight_within: float = 1.5) -> Tensor:
        """Where to go: the unit chord of a few steps of descent, which a single node's gradient does not swing.

        Args:
            p: positions, m, [B, Q, 2]; from outside the grid the chord leads onto it.
            step: length of a step, m.
            steps: number of steps.
            straight_within: distance from the target at which steps go straight to it, m; the interpolated gradient
                there is that of a cone's tip.

        Returns:
            [B, Q, 2], zero at the target.
        """
        end = self._clamped(p)
        for _ in range(steps):
            end = self._step(end, step, straight_within)
        return _unit(end - p)

    def path(self, p: Tensor, step: float = 0.4, max_steps: int = 1000, straight_within: float = 1.5) -> Tensor:
        """Polylines of descent from p [B, Q, 2], [B, Q, K, 2]: until all are at their target, or for `max_steps`."""
        points = [self._clamped(p)]
        for _ in range(max_steps):
            if bool(((self.target[:, None] - points[-1]).norm(dim=-1) <= 1e-3 * step).all()):
                break
            points.append(self._step(points[-1], step, straight_within))
        return torch.stack(points, -2)

    def _clamped(self, p: Tensor) -> Tensor:
        extent = self.spacing * (torch.tensor(self.value.shape[1:], device=p.device) - 1)
        return torch.minimum(torch.maximum(p, self.origin), self.origin + extent)

    def _step(self, p: Tensor, step: float, straight_within: float) -> Tensor:
        """One step of descent, never beyond the target."""
        ahead = self.target[:, None] - p
        distance = ahead.norm(dim=-1, keepdim=True)
        downhill = _interpolate(self.descent, p, self.origin, self.spacing)
        return p + _unit(torch.where(distance < straight_within, ahead, downhill)) * distance.clamp_max(step)


class _Sweeps:
    """The four sweeps of a round over all maps, each a wave that updates one diagonal i + j = k of nodes at once.

    The sweeps differ by the quadrant of their upwind neighbours, so on flipped copies of the grid they are one, towards
    growing i and j, and run side by side to meet in their minimum (Zhao 2007): up to twice the rounds of one after the
    other for a quarter of the calls each, and calls are what a small batch pays for. The copies lie skewed in memory,
    node (i, j) in row i + j + 1 and column i + 1, for a diagonal to be a contiguous slice; the places between stay
    large and serve as the neighbours beyond the edge.
    """

    flips = ((), (0,), (1,), (0, 1))

    def __init__(self, cost: Tensor, large: float) -> None:
        """For the slowness times the spacing [nx, ny, B]."""
        nx, ny, maps = cost.shape
        width = len(self.flips) * maps

        def skewed() -> tuple[Tensor, Tensor]:
            rows = cost.new_full((nx + ny, nx + 1, width), large)
            strides = ((nx + 2) * width, (nx + 1) * width, maps, 1)
            return rows, rows.as_strided((nx, ny, len(self.flips), maps), strides, (nx + 2) * width)

        phi, self.nodes = skewed()
        f, nodes = skewed()
        self._spread(cost, nodes)
        rows = [x.unbind(0) for x in (phi[1:, 1:], phi[:, :-1], phi[:, 1:], f[1:, 1:], f.square().mul_(2.0)[1:, 1:])]
        scratch = [cost.new_empty(nx, width) for _ in range(3)]
        self.lines = []
        for k in range(nx + ny - 1):
            diagonal = slice(max(0, k - ny + 1), min(nx - 1, k) + 1)
            self.lines.append([x[diagonal] for x in [*(row[k] for row in rows), *scratch]])

    def round(self, phi: Tensor) -> Tensor:
        """phi [nx, ny, B] after one round.

        Of |grad Phi| = w with neighbours a, b and f = w h, the Godunov scheme takes
        Phi = (a + b + sqrt(2 f^2 - (a - b)^2)) / 2 if |a - b| < f, else min(a, b) + f, both of which are
        min(a, b) + (m + sqrt(2 f^2 - m^2)) / 2 with m = min(|a - b|, f).
        """
        self._spread(phi, self.nodes)
        # In place and without a fused multiply-add, whose rounding would depend on the size of the batch.
        for own, a, b, f, twice_f2, low, m, root in self.lines:
            torch.minimum(a, b, out=low)
            torch.sub(a, b, out=m)
            torch.minimum(m.abs_(), f, out=m)
            torch.mul(m, m, out=root)
            torch.sub(twice_f2, root, out=root)
            m.add_(root.sqrt_())
            torch.minimum(own, low.add_(m, alpha=0.5), out=own)
        return torch.stack([self.nodes[:, :, i].flip(flip) for i, flip in enumerate(self.flips)]).amin(0)

    def _spread(self, x: Tensor, nodes: Tensor) -> None:
        for i, flip in enumerate(self.flips):
            nodes[:, :, i] = x.flip(flip)


@torch.no_grad()
def solve_eikonal(
    slowness: Tensor, origin: Tensor, spacing: float, target: Tensor, tolerance: float = 1e-6, max_rounds: int = 200
) -> GridMap:
    """Solve |grad Phi| = w, Phi(target) = 0 on regular grids, one target each, by fast sweeping.

    First-order Godunov upwind scheme and Gauss-Seidel sweeps: H. Zhao, "A fast sweeping method for eikonal equations",
    Mathematics of Computation 74, 2005; sweeps side by side: his "Parallel implementations of the fast sweeping
    method", Journal of Computational Mathematics 25, 2007; a diagonal at once: M. Detrixhe, F. Gibou and C. Min, "A
    parallel fast sweeping method for the eikonal equation", Journal of Computational Physics 237, 2013.

    Args:
        slowness: w at the nodes, cost a metre, [B, nx, ny]; large but finite inside obstacles, for the gradient there
            to lead out. A wall must be at least two nodes thick: a single node's gradient leads out on the cheaper
            side, and by interpolation draws ways through from the other.
        origin: position of node (0, 0), m, [2].
        spacing: h, m.
        target: m, [B, 2].
        tolerance: a map is done when a round changes it nowhere by more than this share of its largest value.
        max_rounds: a round is four sweeps; about one for each turn of the ways through a right angle is needed.

    Raises:
        ValueError: a slowness that is not positive and finite, a target outside the grid, a grid under 3 x 3 nodes.
        ArithmeticError: not converged within `max_rounds`.
    """
    if slowness.ndim != 3 or min(slowness.shape[1:]) < 3:
        raise ValueError(f"slowness must be [B, nx, ny] with at least 3 nodes a side, got {list(slowness.shape)}")
    if not bool(((slowness > 0.0) & slowness.isfinite()).all()):
        raise ValueError("slowness must be positive and finite everywhere")
    maps, nx, ny = slowness.shape
    origin, target = origin.to(slowness), target.to(slowness)
    where = (target - origin) / spacing
    if not bool(((where >= 0.0) & (where <= where.new_tensor([nx - 1, ny - 1]))).all()):
        raise ValueError(f"a target lies outside the grid of {nx} x {ny} nodes, {spacing} m apart")

    # The scheme's error grows with Phi's curvature, which has no bound at a point source: start from a disc instead.
    x, y = (origin[axis] + spacing * torch.arange(n).to(slowness) for axis, n in enumerate((nx, ny)))
    distance = torch.hypot(x[:, None, None] - target[:, 0], y[:, None] - target[:, 1])
    at_target = _interpolate(slowness[..., None], target[:, None], origin, spacing)[:, 0, 0]
    w = slowness.permute(1, 2, 0)
    large = math.sqrt(torch.finfo(slowness.dtype).max) / 4.0  # its square, too, is finite
    phi = torch.where(distance <= 2.0 * spacing, distance * (w + at_target) / 2.0, large)

    sweeps = _Sweeps(w * spacing, large)
    active = torch.ones(maps, dtype=torch.bool, device=slowness.device)
    rounds = torch.zeros(maps, dtype=torch.long, device=slowness.device)
    while bool(active.any()):
        if int(rounds.max()) == max_rounds:
            raise ArithmeticError(f"the eikonal sweeps did not converge within {max_rounds} rounds")
        swept = sweeps.round(phi)
        change = (phi - swept).amax((0, 1))
        # Maps that are done stay as they are, so that a batch equals its singles.
        phi = torch.where(active, swept, phi)
        rounds += active
        active &= ~(change <= tolerance * phi.amax((0, 1)))
    value = phi.permute(2, 0, 1).contiguous()
    return GridMap(value, _upwind_descent(value), target, origin, spacing, rounds)
