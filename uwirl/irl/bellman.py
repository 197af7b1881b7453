"""Bellman rows of integral reinforcement learning, and what of them depends on no policy (eqs 42-47).

The integral Bellman equation of a policy tau^s, along data taken under any tau, is linear in the critic's weights and
in those of the improved policy tau^(s+1) = W+' phi3:

    W_c' (phi2(t) - phi2(t+T)) - 2 sum_k R_k W+_k' int phi3_k (tau_k - tau_k^s) dt = int q + sum_k R_k (tau_k^s)^2 dt

With tau_k^s = W_k' phi3_k every integral in it is a linear function of W and of the policy-free vector

    z = [phi2(t) - phi2(t+T);  int phi3_k tau_k;  vech int phi3_k phi3_k' of each axis k;  int q]

so the rows of any policy W are theta = L(W) z with target y = l(W)' z.

Where the least running cost g_bar that can be held for ever is not zero and not known, no critic is finite: what is
finite is the value of cost less its average. g_bar is then one more unknown, whose regressor is the window's length T:

    W_c' (phi2(t) - phi2(t+T)) + g_bar T - 2 sum_k ... = int q + ...
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.quadrature import drop, held_product, simpson


class Segment(NamedTuple):
    """What windows of experience hold; nothing in it depends on a policy.

    Attributes:
        drop: phi2(t) - phi2(t + T), [..., n2].
        drive: int phi3_k tau_k, [..., n3].
        gram: vech int phi3_k phi3_k' axis by axis, [..., g].
        cost: int q, the state cost, [...].
        duration: T, the window's length, s, [...].
    """

    drop: Tensor
    drive: Tensor
    gram: Tensor
    cost: Tensor
    duration: Tensor

    def weighted(self, weight: Tensor) -> Segment:
        """Each window's equation times a weight [...], for weighted least squares."""
        column = weight[..., None]
        return Segment(
            self.drop * column, self.drive * column, self.gram * column, self.cost * weight, self.duration * weight
        )


class BellmanOperator:
    """Builds rows for any policy out of policy-free segments.

    The unknowns of a row are [W_c, n2; W+, n3] and, where the average cost is one of them, [g_bar, 1].

    Args:
        critic_features: n2.
        actor_features: number of features of each control axis; n3 is their sum.
        R: control weight of each axis.
        actor_sign: -1, the sign that follows from (42). # phi(t) under (49) prints +1, which converges to wrong gains.
        average_cost: whether the average cost g_bar is an unknown, because it is not known to be zero.
    """

    def __init__(
        self,
        critic_features: int,
        actor_features: Sequence[int],
        R: Sequence[float] | Tensor,
        actor_sign: float = -1.0,
        average_cost: bool = False,
    ):
        self.n2 = critic_features
        self.sizes = tuple(actor_features)
        self.n3 = sum(self.sizes)
        self.actor_sign = actor_sign
        self.average_cost = average_cost
        R = torch.as_tensor(R, dtype=torch.float64)
        self.R = R.repeat_interleave(torch.tensor(self.sizes, device=R.device))
        offsets = torch.tensor([0, *self.sizes]).cumsum(0)[:-1].tolist()
        pairs = [
            (offset + i, offset + j)
            for offset, size in zip(offsets, self.sizes, strict=True)
            for i in range(size)
            for j in range(i, size)
        ]
        self.first = torch.tensor([i for i, _ in pairs])
        self.second = torch.tensor([j for _, j in pairs])
        # pairing[i, c, j] = 1 where entry c of vech holds the pair {i, j}: (G W)_i = sum_cj pairing[i, c, j] gram_c W_j
        self.pairing = torch.zeros(self.n3, len(pairs), self.n3, dtype=torch.float64)
        for c, (i, j) in enumerate(pairs):
            self.pairing[i, c, j] = self.pairing[j, c, i] = 1.0

    @property
    def unknowns(self) -> int:
        """n2 + n3, and one for an average cost that is not known."""
        return self.n2 + self.n3 + int(self.average_cost)

    def z(self, segment: Segment) -> Tensor:
        """The policy-free vector [..., nz] of windows [...]; where g_bar is an unknown, T stands at its end."""
        columns = [segment.drop, segment.drive, segment.gram, segment.cost[..., None]]
        return torch.cat([*columns, segment.duration[..., None]] if self.average_cost else columns, -1)

    def split(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        """W_c [..., n2], W+ [..., n3] and g_bar [...] of unknowns [..., n]; None for g_bar if it is not one of them."""
        critic, actor, rest = unknowns.split([self.n2, self.n3, int(self.average_cost)], -1)
        return critic, actor, rest[..., 0] if self.average_cost else None

    def products(self, phi3: Tensor) -> Tensor:
        """vech phi3_k phi3_k' axis by axis, [..., g], of phi3 [..., n3]."""
        return phi3[..., self.first.to(phi3.device)] * phi3[..., self.second.to(phi3.device)]

    def segment(
        self, phi2: Tensor, phi3: Tensor, tau: Tensor, q: Tensor, dt: float, steps: int, stride: int, held: bool = True
    ) -> Segment:
        """Integrate a sampled trajectory over its windows.

        Args:
            phi2: critic features at the nodes, [n + 1, ..., n2].
            phi3: actor features at the nodes, [n + 1, ..., n3].
            tau: control, one value for each axis: held over each step, [n, ..., m], or at the nodes, [n + 1, ..., m].
            q: state cost at the nodes, [n + 1, ...].
            dt: s.
            steps: steps per window, even.
            stride: steps between the starts of two windows.
            held: whether tau is constant over each step.

        Returns:
            Segment of shape [S, ...].
        """
        tau = tau.repeat_interleave(torch.tensor(self.sizes, device=tau.device), dim=-1, output_size=self.n3)
        if held:
            drive = held_product(phi3, tau, dt, steps, stride)
        else:
            drive = simpson(phi3 * tau, dt, steps, stride)
        cost = simpson(q, dt, steps, stride)
        return Segment(
            drop=drop(phi2, steps, stride),
            drive=drive,
            gram=simpson(self.products(phi3), dt, steps, stride),
            cost=cost,
            duration=torch.full_like(cost, steps * dt),
        )

    def lift(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """L(W) [..., n, nz] and l(W) [..., nz] of a policy W [..., n3]."""
        batch = weights.shape[:-1]
        policy_gram = torch.einsum("icj,...j->...ic", self.pairing.to(weights), weights)
        R = self.R.to(weights)
        g = self.pairing.shape[1]
        critic, actor = slice(self.n2), slice(self.n2, self.n2 + self.n3)
        gram, cost = slice(actor.stop, actor.stop + g), actor.stop + g
        nz = cost + 1 + int(self.average_cost)
        L = weights.new_zeros(*batch, self.unknowns, nz)
        L[..., critic, critic] = torch.eye(self.n2, dtype=weights.dtype, device=weights.device)
        L[..., actor, actor] = torch.diag(2.0 * self.actor_sign * R)
        L[..., actor, gram] = -2.0 * self.actor_sign * R[:, None] * policy_gram
        if self.average_cost:
            L[..., -1, -1] = 1.0
        target = weights.new_zeros(*batch, nz)
        target[..., gram] = ((R * weights)[..., None] * policy_gram).sum(-2)
        target[..., cost] = 1.0
        return L, target

    def rows(self, segment: Segment, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Rows theta [S, ..., n] and targets y [S, ...] of a policy W [..., n3], rebuilt from segments [S, ...]."""
        L, target = self.lift(weights)
        z = self.z(segment)
        return (L @ z[..., None])[..., 0], (target * z).sum(-1)
