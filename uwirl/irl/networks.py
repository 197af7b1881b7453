"""Critic and actor (eqs 27, 45, 46), linear in their basis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor, nn


class Basis(Protocol):
    """Features of critic and actor."""

    @property
    def critic_names(self) -> Sequence[str]:
        """Name of each of the n2 critic features."""
        ...

    @property
    def actor_names(self) -> Sequence[Sequence[str]]:
        """For each control axis, the names of its features; n3 is their number over all axes."""
        ...

    def critic(self, x: Tensor) -> Tensor:
        """phi2(x), [..., n2]."""
        ...

    def actor(self, x: Tensor) -> Tensor:
        """phi3(x), axis after axis, [..., n3]."""
        ...


class LinearCritic(nn.Module):
    """V(x) = W' phi2(x)    (45).

    The weight is [L, n2], one row a learner; it is a buffer because least squares sets it, not a gradient.
    """

    def __init__(self, basis: Basis, learners: int = 1, dtype: torch.dtype = torch.float64):
        super().__init__()
        self.basis = basis
        self.weight: Tensor
        self.register_buffer("weight", torch.zeros(learners, len(basis.critic_names), dtype=dtype))

    def forward(self, x: Tensor) -> Tensor:
        """V [..., L] of states x [..., L, d]."""
        return (self.weight * self.basis.critic(x)).sum(-1)


class LinearActor(nn.Module):
    """tau_k(x) = W_k' phi3_k(x) on each control axis k    (46).

    The weight is [L, n3], axis after axis, one row a learner.
    """

    def __init__(self, basis: Basis, weight: Tensor):
        super().__init__()
        self.basis = basis
        self.sizes = tuple(len(names) for names in basis.actor_names)
        if weight.shape[-1] != sum(self.sizes):
            raise ValueError(f"actor weight has {weight.shape[-1]} entries, its basis {sum(self.sizes)} features")
        self.weight: Tensor
        self.summation: Tensor
        self.register_buffer("weight", weight)
        axis = torch.arange(len(self.sizes)).repeat_interleave(torch.tensor(self.sizes))
        self.register_buffer("summation", torch.eye(len(self.sizes), dtype=weight.dtype)[axis].to(weight.device))

    def forward(self, x: Tensor) -> Tensor:
        """tau [..., L, m] of states x [..., L, d]."""
        return (self.weight * self.basis.actor(x)) @ self.summation
