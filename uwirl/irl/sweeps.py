"""Sweeps of the fast sweeping method for the eikonal equation, over all maps of a batch at once.

A round is 2^d sweeps, each a wave that updates one diagonal i + j + ... = k of nodes at once (M. Detrixhe, F. Gibou and
C. Min, "A parallel fast sweeping method for the eikonal equation", Journal of Computational Physics 237, 2013). They
differ by the quadrant of their upwind neighbours, so on flipped copies of the grid they are one, towards growing
indices, and run side by side to meet in their minimum (H. Zhao, "Parallel implementations of the fast sweeping method",
Journal of Computational Mathematics 25, 2007): up to twice the rounds of one after the other for a fraction of the
calls each, and calls are what a small batch pays for.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, combinations

import torch
from torch import Tensor


class SquareSweeps:
    """Sweeps in two dimensions with one spacing, of which a planner needs many.

    The copies lie skewed in memory, node (i, j) in row i + j + 1 and column i + 1, for a diagonal to be a contiguous
    slice; the places between stay large and serve as the neighbours beyond the edge.
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


class BoxSweeps:
    """Sweeps in any number of dimensions, with a spacing for each axis."""

    def __init__(self, w: Tensor, spacing: Sequence[float], large: float) -> None:
        """For the slowness [*n, B] and the spacing of each axis."""
        *sides, maps = w.shape
        axes = range(len(sides))
        self.flips = list(chain.from_iterable(combinations(axes, count) for count in range(len(sides) + 1)))
        self.spacing = w.new_tensor(spacing)
        # One plane before the first node of each axis stays large and serves as the neighbours beyond the edge.
        padded = [n + 1 for n in sides]
        phi, inside = w.new_full((*padded, len(self.flips), maps), large), tuple(slice(1, None) for _ in axes)
        self.nodes, self.flat = phi[inside], phi.flatten(0, -3)
        slowness = torch.empty_like(self.nodes)
        self._spread(w, slowness)
        slowness = slowness.flatten(0, -3)
        place = torch.arange(len(self.flat), device=w.device).view(padded)
        before = torch.stack([place.roll(1, axis)[inside].flatten() for axis in axes])
        indices = torch.meshgrid(*[torch.arange(n, device=w.device) for n in sides], indexing="ij")
        diagonal = sum(indices[1:], indices[0]).flatten()
        place = place[inside].flatten()
        order = diagonal.argsort(stable=True).split(diagonal.bincount().tolist())
        self.diagonals = [(place[k], before[:, k], slowness[k]) for k in order]

    def round(self, phi: Tensor) -> Tensor:
        """phi [*n, B] after one round."""
        self._spread(phi, self.nodes)
        for own, before, w in self.diagonals:
            neighbours, axis = self.flat[before].sort(dim=0, stable=True)
            candidate = neighbours[0] + _rise(neighbours - neighbours[0], self.spacing[axis], w)
            self.flat[own] = torch.minimum(self.flat[own], candidate)
        return torch.stack([self.nodes[..., i, :].flip(flip) for i, flip in enumerate(self.flips)]).amin(0)

    def _spread(self, x: Tensor, nodes: Tensor) -> None:
        for i, flip in enumerate(self.flips):
            nodes[..., i, :] = x.flip(flip)


def _rise(b: Tensor, h: Tensor, w: Tensor) -> Tensor:
    """Godunov's rise t above the least neighbour: sum_i (max(t - b_i, 0) / h_i)^2 = w^2.

    A neighbour that lies higher than the rise without it takes no part, and cutting it down to that rise makes its term
    zero: so one neighbour after the other enters, from the lowest, and the last quadratic holds for all cases.

    Args:
        b: neighbours above the least, in rising order, [d, ...].
        h: the spacing along each one's axis, [d, ...].
        w: slowness, [...].
    """
    t = h[0] * w
    A = h[0] ** -2
    B, C = torch.zeros_like(t), -w * w
    for b_i, h_i in zip(b[1:], h[1:], strict=True):
        low, share = torch.minimum(b_i, t), h_i**-2
        A, B, C = A + share, B + share * low, C + share * low * low
        t = (B + (B * B - A * C).clamp_min(0.0).sqrt()) / A
    return t
