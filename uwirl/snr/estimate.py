"""The result of stage 1: the estimated channel and its uncertainty."""

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
        identifiable: whether the readings determine it, bool [B]; if not, value and std have no meaning.
    """

    value: Tensor
    std: Tensor
    identifiable: Tensor


@dataclass(frozen=True)
class ChannelEstimate:
    """Estimates of the channel from B data sets, one for each vehicle.

    Attributes:
        budget: what was known beforehand.
        value: K (dB), n, zeta^2 (dB^2), varphi (m), rho^2 (dB^2), [B, 5].
        covariance: covariance of K, n and the logarithms of the other three, [B, 5, 5].
        identifiable: which parameters the readings determine, bool [B, 5].
        cost: negative log likelihood minus m/2 ln(2 pi), with m readings, [B].
        evaluations: number of evaluations of the cost.
    """

    budget: LinkBudget
    value: Tensor
    covariance: Tensor
    identifiable: Tensor
    cost: Tensor
    evaluations: int

    def parameter(self, name: str) -> Parameter:
        """The parameter with this name, one of NAMES."""
        k = NAMES.index(name)
        std = self.covariance[:, k, k].sqrt()
        # To first order, the standard error of a logarithm is the relative standard error of the parameter.
        return Parameter(self.value[:, k], std if k < 2 else self.value[:, k] * std, self.identifiable[:, k])

    @property
    def theta(self) -> Tensor:
        """K and n, [B, 2]."""
        return self.value[:, :2]

    @property
    def channel(self) -> Channel:
        """The channel with the estimated values, [B] each, for planning in stage 2.

        Shadowing that cannot be distinguished from multipath is counted as multipath.
        """
        K, n, zeta2, varphi, rho2 = self.value.unbind(-1)
        separable = self.identifiable[:, 2] & self.identifiable[:, 3]
        zeta, rho = torch.where(separable, zeta2, 0.0).sqrt(), torch.where(separable, rho2, zeta2 + rho2).sqrt()
        return Channel(self.budget, K_dB=K, n=n, zeta_dB=zeta, varphi_m=varphi, rho_dB=rho)

    def state_dict(self) -> dict[str, Any]:
        """All attributes except the budget, as tensors and a number."""
        return {name: getattr(self, name) for name in _TENSORS} | {"evaluations": self.evaluations}

    @classmethod
    def from_state(cls, state: dict[str, Any], budget: LinkBudget) -> ChannelEstimate:
        """The estimate with this `state_dict` and this budget."""
        return cls(budget=budget, **state)

    def select(self, rows: Tensor) -> ChannelEstimate:
        """The estimates from some data sets, by a mask or numbers."""
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
