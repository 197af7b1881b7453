"""What stage 1 hands to everything else: the estimated channel and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from uwirl.world.acoustics import Channel


@dataclass(frozen=True)
class Parameter:
    """One estimated channel parameter.

    Attributes:
        value: the estimate, or None where the data cannot tell.
        std: its standard error; 0 if known exactly, None if unidentifiable.
    """

    value: float | None
    std: float | None

    @property
    def identifiable(self) -> bool:
        return self.value is not None

    def __str__(self) -> str:
        return "unidentifiable" if self.value is None else f"{self.value:.4g} +- {self.std:.2g}"


@dataclass(frozen=True)
class ChannelEstimate:
    """Estimate of one vehicle's channel.

    Attributes:
        channel: the channel with its estimated K, n and rho in place, which stage 2 plans on.
        K_dB, n, rho2: the parameters, with standard errors.
        covariance: of theta = (K, n), [2, 2].
    """

    channel: Channel
    K_dB: Parameter
    n: Parameter
    rho2: Parameter
    covariance: Tensor

    def __str__(self) -> str:
        return ", ".join(f"{name} = {p}" for name, p in (("K (dB)", self.K_dB), ("n", self.n), ("rho^2", self.rho2)))
