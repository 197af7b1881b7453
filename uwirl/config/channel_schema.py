"""Names, types and units of the channel's settings, which planning and surveying share."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING


@dataclass
class WaterConfig:
    """Read by the absorption laws francois_garrison and, but for salinity and acidity, fisher_simmons."""

    temperature_C: float = 10.0
    salinity_ppt: float = 35.0
    depth_m: float = 0.0
    pH: float = 8.0


@dataclass
class ChannelConfig:
    K_dB: float = MISSING  # the source level in dB re 1 uPa at 1 m, if N0_dB is the noise level in dB re 1 uPa
    n: float = MISSING
    N0_dB: float = MISSING
    bandwidth_khz: float = MISSING
    absorption: str = MISSING  # none | thorp | francois_garrison | fisher_simmons
    frequency_khz: float | None = MISSING  # null with absorption none
    zeta_dB: float = MISSING  # standard deviation of shadowing
    varphi_m: float = MISSING  # its correlation distance
    rho_dB: float = MISSING  # standard deviation of multipath
    water: WaterConfig = field(default_factory=lambda: WaterConfig())
