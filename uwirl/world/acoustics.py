"""The underwater acoustic channel: absorption, mean SNR and capacity (eqs 5-8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor


def thorp_absorption(frequency_khz: float) -> float:
    """Absorption a(f) in dB/km under (6), Thorp's law, with f in kHz.

    a(f) = 0.11 f^2/(1 + f^2) + 44 f^2/(4100 + f^2) + 2.75e-4 f^2 + 0.003
    """
    f2 = frequency_khz**2
    return 0.11 * f2 / (1.0 + f2) + 44.0 * f2 / (4100.0 + f2) + 2.75e-4 * f2 + 0.003


ABSORPTION_LAWS = {"thorp": thorp_absorption}


@dataclass(frozen=True)
class Channel:
    """Mean (path-loss) channel of one acoustic link and the power of its multipath.

    SNR_dB(l) = K - 10 n log10(l) - (l / 1000) a(f) - N0           (6) without its random terms
    C(l) = B log2(1 + 10^(SNR_dB / 10))                            (7), (8)

    The paper multiplies a(f), which is in dB/km, by metres; here the distance is divided by 1000.

    Attributes:
        K_dB: transmission constant, dB; a number, or a tensor where worlds differ (an estimate).
        n: spreading exponent, likewise.
        N0_dB: noise level, dB.
        bandwidth_khz: B, kHz, so that capacities are in kbit/s.
        absorption: name of an absorption law, or "none".
        frequency_khz: f, kHz; only with an absorption law.
        rho_dB: standard deviation of multipath, Gaussian in dB.
    """

    K_dB: float | Tensor
    n: float | Tensor
    N0_dB: float
    bandwidth_khz: float
    absorption: str = "none"
    frequency_khz: float | None = None
    rho_dB: float = 0.0

    @property
    def absorption_dB_per_km(self) -> float:
        if self.absorption == "none":
            return 0.0
        if self.frequency_khz is None:
            raise ValueError(f"channel.frequency_khz: absorption={self.absorption} needs a frequency in kHz")
        return ABSORPTION_LAWS[self.absorption](self.frequency_khz)

    def known_loss_dB(self, distance_m: Tensor) -> Tensor:
        """epsilon under (10): noise and absorption, the part of (6) that needs no estimation, dB."""
        return self.N0_dB + distance_m * (self.absorption_dB_per_km / 1000.0)

    def mean_snr_dB(self, distance_m: Tensor) -> Tensor:
        """Path-loss SNR of (6), dB, same shape as the distance in m."""
        return self.K_dB - 10.0 * self.n * torch.log10(distance_m) - self.known_loss_dB(distance_m)

    def capacity_kbps(self, snr_dB: Tensor) -> Tensor:
        """Shannon capacity (7) of an SNR in dB, kbit/s."""
        return self.bandwidth_khz * torch.log1p(10.0 ** (snr_dB / 10.0)) / math.log(2.0)

    def mean_capacity_kbps(self, distance_m: Tensor) -> Tensor:
        """Capacity of path loss alone over a distance in m, kbit/s."""
        return self.capacity_kbps(self.mean_snr_dB(distance_m))
