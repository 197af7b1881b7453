"""What stage 1 hands to everything else: the estimated channel and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.world.acoustics import Channel, LinkBudget

NAMES = ("K_dB", "n", "zeta2", "varphi_m", "rho2")
_TENSORS = ("value", "covariance", "identifiable", "cost")


class Parameter(NamedTuple):
    """One channel parameter of B data sets.

    Attributes:
        value: [B].
        std: standard error, [B].
        identifiable: whether the readings tell it, bool [B]; where not, the other two mean nothing.
    """

    value: Tensor
    std: Tensor
    identifiable: Tensor


@dataclass(frozen=True)
class ChannelEstimate:
    """Estimates of the channel from B data sets, of one vehicle each.

    Attributes:
        budget: what was known beforehand.
        value: K (dB), n, zeta^2 (dB^2), varphi (m), rho^2 (dB^2), [B, 5].
        covariance: of K, n and the logarithms of the other three, [B, 5, 5].
        identifiable: which of them the readings tell, bool [B, 5].
        cost: negative log likelihood less m/2 ln(2 pi), [B].
        evaluations: of the cost.
    """

    budget: LinkBudget
    value: Tensor
    covariance: Tensor
    identifiable: Tensor
    cost: Tensor
    evaluations: int

    def parameter(self, name: str) -> Parameter:
        """One of NAMES."""
        k = NAMES.index(name)
        std = self.covariance[:, k, k].sqrt()
        # To first order a logarithm's standard error is a relative one.
        return Parameter(self.value[:, k], std if k < 2 else self.value[:, k] * std, self.identifiable[:, k])

    @property
    def theta(self) -> Tensor:
        """K and n, [B, 2]."""
        return self.value[:, :2]

    @property
    def channel(self) -> Channel:
        """The channel with its estimated values in place, [B] each, which stage 2 plans on.

        Shadowing that cannot be told from multipath counts as such.
        """
        K, n, zeta2, varphi, rho2 = self.value.unbind(-1)
        separable = self.identifiable[:, 2] & self.identifiable[:, 3]
        zeta, rho = torch.where(separable, zeta2, 0.0).sqrt(), torch.where(separable, rho2, zeta2 + rho2).sqrt()
        return Channel(self.budget, K_dB=K, n=n, zeta_dB=zeta, varphi_m=varphi, rho_dB=rho)

    def state_dict(self) -> dict[str, Any]:
        """All but what was known before, as tensors and a number."""
        return {name: getattr(self, name) for name in _TENSORS} | {"evaluations": self.evaluations}

    @classmethod
    def from_state(cls, state: dict[str, Any], budget: LinkBudget) -> ChannelEstimate:
        """What `state_dict` told, and what is known beforehand."""
        return cls(budget=budget, **state)

    def select(self, rows: Tensor) -> ChannelEstimate:
        """Those of some data sets, by a mask or numbers."""
        tensors: dict[str, Any] = {name: getattr(self, name)[rows] for name in _TENSORS}
        return replace(self, **tensors)

    @classmethod
    def join(cls, parts: list[ChannelEstimate]) -> ChannelEstimate:
        """Estimates of several vehicles, one after the other."""
        joined: dict[str, Any] = {name: torch.cat([getattr(part, name) for part in parts]) for name in _TENSORS}
        return replace(parts[0], **joined, evaluations=max(part.evaluations for part in parts))

    def __str__(self) -> str:
        lines = []
        for b in range(len(self.value)):
            texts = []
            for name, symbol in zip(NAMES, ("K (dB)", "n", "zeta^2", "varphi (m)", "rho^2"), strict=True):
                value, std, identifiable = (float(x[b]) for x in self.parameter(name))
                texts.append(f"{symbol} = " + (f"{value:.4g} +- {std:.2g}" if identifiable else "unidentifiable"))
            lines.append(", ".join(texts))
        return "\n".join(lines)
