"""Linear-quadratic subproblems of optimal control: a Riccati recursion over time, batched over problems.

    minimise    sum_k g_k' z_k + 1/2 z_k' H_k z_k,   z_k = (dx_k, du_k)
    subject to  dx_k+1 = A_k dx_k + B_k du_k + d_k,   dx_0 given,   low_k <= du_k <= high_k

Step after step in time, everything of a step in four calls: a few hundred steps take tens of milliseconds for one or
for a hundred problems. (D. Jacobson and D. Mayne, Differential Dynamic Programming, 1970; bounds on the control as in
Y. Tassa et al., "Control-limited differential dynamic programming", ICRA 2014: approximately, see `solve`.)
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor


class LinearQuadratic(NamedTuple):
    """K problems of N steps, n states and m controls.

    Attributes:
        dynamics: A, B and d side by side, [N, K, n, n + m + 1].
        cost: H of z and, in the last column, its gradient g, [N, K, n + m, n + m + 1].
        final: the same of dx_N, [K, n, n + 1].
        low, high: bounds of du around zero, [N, K, m].
    """

    dynamics: Tensor
    cost: Tensor
    final: Tensor
    low: Tensor
    high: Tensor


class Step(NamedTuple):
    """Solution of K problems.

    Attributes:
        dx: [N + 1, K, n].
        du: [N, K, m].
        gain: du = gain dx + ..., [N, K, m, n].
        costate: gradient of the cost to go at dx = 0, [N + 1, K, n].
    """

    dx: Tensor
    du: Tensor
    gain: Tensor
    costate: Tensor


def solve(problem: LinearQuadratic, start: Tensor) -> Step:
    """The solution from dx_0 [K, n].

    A control at a bound that the cost pushes outwards stays there; one that would pass a bound stops at it, which its
    law and the costs to go do not foresee.

    Raises:
        torch.linalg.LinAlgError: the cost is not convex in the controls.
    """
    N, _, n, columns = problem.dynamics.shape
    m = columns - n - 1
    affine = torch.arange(n + m + 1, device=start.device) == n + m
    rest = torch.cat([torch.arange(n), torch.tensor([n + m])]).to(start.device)
    transposed = problem.dynamics[..., :-1].mT.contiguous()
    at_low, at_high = problem.low >= 0.0, problem.high <= 0.0
    bounded = (at_low | at_high).flatten(1).any(-1).tolist()
    value = problem.final
    laws, costates = [], [value[..., -1]]
    for k in range(N - 1, -1, -1):
        ahead = value[..., :-1] @ problem.dynamics[k] + value[..., -1:] * affine
        all_of = torch.baddbmm(problem.cost[k], transposed[k], ahead)
        hessian, right = all_of[:, n:, n : n + m], all_of[:, n:][..., rest]
        if bounded[k]:
            push = right[..., -1]
            held = (at_low[k] & (push > 0.0)) | (at_high[k] & (push < 0.0))
            right = right.masked_fill(held[..., None], 0.0)
            both = held[..., None] | held[..., None, :]
            hessian = hessian.masked_fill(both, 0.0) + torch.diag_embed(held.to(hessian))
        law = -torch.linalg.solve(hessian, right)
        value = all_of[:, :n][..., rest] + all_of[:, :n, n : n + m] @ law
        value = torch.cat([(value[..., :-1] + value[..., :-1].mT) / 2.0, value[..., -1:]], -1)
        laws.append(law)
        costates.append(value[..., -1])
    law = torch.stack(laws[::-1])
    dx, du = [start], []
    one = torch.ones_like(start[:, :1])
    for k in range(N):
        wanted = (law[k] @ torch.cat([dx[-1], one], -1)[..., None])[..., 0]
        du.append(torch.maximum(torch.minimum(wanted, problem.high[k]), problem.low[k]))
        dx.append((problem.dynamics[k] @ torch.cat([dx[-1], du[-1], one], -1)[..., None])[..., 0])
    return Step(torch.stack(dx), torch.stack(du), law[..., :-1], torch.stack(costates[::-1]))
