"""Names, types and units of the channel's settings, which planning and surveying share."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from uwirl.config.own_schema import OwnConfig


@dataclass
class WaterConfig:
    """Read by the absorption laws francois_garrison and, but for salinity and acidity, fisher_simmons."""

    temperature_C: float = 10.0  # degrees Celsius, in [-2, 35]
    salinity_ppt: float = 35.0  # parts per thousand, in [0, 45]
    depth_m: float = 0.0  # m, in [0, 11000]
    pH: float = 8.0  # acidity, in [7, 9]


@dataclass
class ChannelParameters:
    K_dB: float = MISSING  # dB; the source level in dB re 1 uPa at 1 m, if N0_dB is the noise level in dB re 1 uPa
    n: float = MISSING  # path loss exponent: the SNR falls by 10 n dB per decade of distance
    N0_dB: float = MISSING  # dB; noise level
    bandwidth_khz: float = MISSING  # kHz; width of the band
    absorption: str = MISSING  # none | thorp | francois_garrison | fisher_simmons
    frequency_khz: float | None = MISSING  # kHz; null with absorption none
    zeta_dB: float = MISSING  # dB; standard deviation of shadowing
    varphi_m: float = MISSING  # m; its correlation distance
    rho_dB: float = MISSING  # dB; standard deviation of multipath
    water: WaterConfig = field(default_factory=lambda: WaterConfig())  # what the absorption depends on


@dataclass
class ChannelConfig(OwnConfig, ChannelParameters):
    pass
