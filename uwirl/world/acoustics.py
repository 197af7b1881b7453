"""The underwater acoustic channel: absorption, mean SNR and capacity (eqs 5-8).

Two types separate what is known beforehand (`LinkBudget`) from the channel itself (`Channel`). Estimators and planners
get the budget, and must estimate the channel from readings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from torch import Tensor

from uwirl.world.absorption import ABSORPTION_LAWS, Water

# 10 log10(x) = DECIBEL ln(x). PyTorch's log10 and powers depend in their last digit on how many worlds are in a batch;
# its ln and exp do not, so that a batch of flights equals its singles.
DECIBEL = 10.0 / math.log(10.0)


@dataclass(frozen=True)
class LinkBudget:
    """What is known about acoustic links beforehand: noise, bandwidth, absorption, and the capacity at a given SNR.

    Attributes:
        N0_dB: noise level, dB.
        bandwidth_khz: B, kHz, so that capacities are in kbit/s.
        absorption: name of an absorption law, or "none".
        frequency_khz: f, kHz; only with an absorption law.
        water: properties of the water, for the absorption law.
    """

    N0_dB: float
    bandwidth_khz: float
    absorption: str = "none"
    frequency_khz: float | None = None
    water: Water = field(default_factory=Water)

    @cached_property
    def absorption_dB_per_km(self) -> float:
        """a(f), dB/km.

        Raises:
            ValueError: an absorption law without a frequency.
        """
        if self.absorption == "none":
            return 0.0
        if self.frequency_khz is None:
            raise ValueError(f"channel.frequency_khz: absorption={self.absorption} needs a frequency in kHz")
        return ABSORPTION_LAWS[self.absorption](self.frequency_khz, self.water)

    def known_loss_dB(self, distance_m: Tensor) -> Tensor:
        """epsilon below (10): noise and absorption, the part of (6) that needs no estimation, dB."""
        # The paper multiplies a(f), which is in dB/km, by metres.
        return self.N0_dB + distance_m * (self.absorption_dB_per_km / 1000.0)

    def capacity_kbps(self, snr_dB: Tensor) -> Tensor:
        """Shannon capacity (7) of an SNR in dB, kbit/s."""
        return self.bandwidth_khz * torch.log1p(torch.exp(snr_dB / DECIBEL)) / math.log(2.0)

    def snr_for_dB(self, capacity_kbps: float) -> float:
        """The SNR in dB that gives a capacity in kbit/s: the inverse of (7)."""
        return 10.0 * math.log10(math.expm1(math.log(2.0) * capacity_kbps / self.bandwidth_khz))


@dataclass(frozen=True)
class Channel:
    """Mean (path-loss) channel of acoustic links, and the statistics of their fading: the truth, or a belief about it.

    SNR_dB(l) = K - 10 n log10(l) - (l / 1000) a(f) - N0           (6) without its random terms
    C(l) = B log2(1 + 10^(SNR_dB / 10))                            (7), (8)

    If N0 is the noise level in the band, in dB re 1 uPa, then K is the source level in dB re 1 uPa at 1 m.

    Attributes:
        budget: what is known beforehand.
        K_dB: transmission constant, dB; a number, or [M] if it differs between vehicles (estimates).
        n: spreading exponent (path-loss exponent); a number or [M].
        zeta_dB: standard deviation of shadowing, Gaussian in dB; see `uwirl.world.fading`.
        varphi_m: correlation distance of the shadowing, m.
        rho_dB: standard deviation of multipath, Gaussian in dB.
    """

    budget: LinkBudget
    K_dB: float | Tensor
    n: float | Tensor
    zeta_dB: float | Tensor = 0.0
    varphi_m: float | Tensor = math.inf
    rho_dB: float | Tensor = 0.0

    @classmethod
    def paper(cls) -> Channel:
        """channel=paper: constants that reproduce the capacities in the paper."""
        return cls(LinkBudget(N0_dB=-160.0, bandwidth_khz=10.0), -60.0, 5.0, zeta_dB=0.07, varphi_m=3.51, rho_dB=0.2864)

    def mean_snr_dB(self, distance_m: Tensor) -> Tensor:
        """Path-loss SNR of (6), dB, same shape as the distance in m."""
        # Estimates are float64 whatever the environment's dtype.
        K, n = (x.to(distance_m) if isinstance(x, Tensor) else x for x in (self.K_dB, self.n))
        return K - DECIBEL * n * torch.log(distance_m) - self.budget.known_loss_dB(distance_m)

    def capacity_kbps(self, snr_dB: Tensor) -> Tensor:
        """Capacity of an SNR in dB, kbit/s."""
        return self.budget.capacity_kbps(snr_dB)

    def mean_capacity_kbps(self, distance_m: Tensor) -> Tensor:
        """Capacity of path loss alone over a distance in m, kbit/s."""
        return self.capacity_kbps(self.mean_snr_dB(distance_m))

    def of(self, vehicle: Tensor) -> Channel:
        """The channel of some vehicles, by their numbers [K], counted through all worlds."""

        def own(value: float | Tensor) -> float | Tensor:
            return value[vehicle % len(value)] if isinstance(value, Tensor) else value

        return replace(
            self,
            K_dB=own(self.K_dB),
            n=own(self.n),
            zeta_dB=own(self.zeta_dB),
            varphi_m=own(self.varphi_m),
            rho_dB=own(self.rho_dB),
        )
