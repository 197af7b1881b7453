"""Absorption of sound in sea water, a(f) in dB/km."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Water:
    """Properties of sea water that determine the absorption of sound.

    Attributes:
        temperature_C: degrees Celsius.
        salinity_ppt: parts per thousand.
        depth_m: m, positive down.
        pH: acidity.
    """

    temperature_C: float = 10.0
    salinity_ppt: float = 35.0
    depth_m: float = 0.0
    pH: float = 8.0


def thorp(frequency_khz: float, water: Water) -> float:
    """Thorp's formula below (6), for 4 degrees Celsius at a depth of 900 m; it ignores the given water.

    a(f) = 0.11 f^2/(1 + f^2) + 44 f^2/(4100 + f^2) + 2.75e-4 f^2 + 0.003
    """
    f2 = frequency_khz**2
    return 0.11 * f2 / (1.0 + f2) + 44.0 * f2 / (4100.0 + f2) + 2.75e-4 * f2 + 0.003


def _relaxation(frequency_khz: float, relaxation_khz: float) -> float:
    """f_r f^2 / (f_r^2 + f^2)."""
    return relaxation_khz * frequency_khz**2 / (relaxation_khz**2 + frequency_khz**2)


def francois_garrison(frequency_khz: float, water: Water) -> float:
    """Formula of Francois and Garrison: boric acid, magnesium sulphate and pure water, 0.2 kHz to 1 MHz.

    R. E. Francois, G. R. Garrison: "Sound absorption based on ocean measurements. Part II: Boric acid contribution and
    equation for total absorption", J. Acoust. Soc. Am. 72(6), 1879-1890, 1982.
    """
    T, S, D = water.temperature_C, water.salinity_ppt, water.depth_m
    kelvin = 273.0 + T
    speed = 1412.0 + 3.21 * T + 1.19 * S + 0.0167 * D
    boric = 8.86 / speed * 10.0 ** (0.78 * water.pH - 5.0)
    boric_khz = 2.8 * math.sqrt(S / 35.0) * 10.0 ** (4.0 - 1245.0 / kelvin)
    sulphate = 21.44 * S / speed * (1.0 + 0.025 * T) * (1.0 - 1.37e-4 * D + 6.2e-9 * D**2)
    sulphate_khz = 8.17 * 10.0 ** (8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (S - 35.0))
    if T <= 20.0:
        pure = 4.937e-4 - 2.59e-5 * T + 9.11e-7 * T**2 - 1.50e-8 * T**3
    else:
        pure = 3.964e-4 - 1.146e-5 * T + 1.45e-7 * T**2 - 6.5e-10 * T**3
    pure *= 1.0 - 3.83e-5 * D + 4.9e-10 * D**2
    salts = boric * _relaxation(frequency_khz, boric_khz) + sulphate * _relaxation(frequency_khz, sulphate_khz)
    return salts + pure * frequency_khz**2


def fisher_simmons(frequency_khz: float, water: Water) -> float:
    """Formula of Fisher and Simmons, 10 to 400 kHz, for a salinity of 35 and pH 8; it ignores the given ones.

    F. H. Fisher, V. P. Simmons: "Sound absorption in sea water", J. Acoust. Soc. Am. 62(3), 558-564, 1977.
    """
    T, f = water.temperature_C, 1e3 * frequency_khz
    kelvin, atmospheres = 273.1 + T, water.depth_m / 10.0
    boric = 1.03e-8 + 2.36e-10 * T - 5.22e-12 * T**2
    boric_hz = 1.32e3 * kelvin * math.exp(-1700.0 / kelvin)
    sulphate = (5.62e-8 + 7.52e-10 * T) * (1.0 - 10.3e-4 * atmospheres + 3.7e-7 * atmospheres**2)
    sulphate_hz = 1.55e7 * kelvin * math.exp(-3052.0 / kelvin)
    pure = 55.9e-15 - 2.37e-15 * T + 4.77e-17 * T**2 - 3.48e-19 * T**3
    pure *= 1.0 - 3.84e-4 * atmospheres + 7.57e-8 * atmospheres**2
    nepers_per_m = boric * _relaxation(f, boric_hz) + sulphate * _relaxation(f, sulphate_hz) + pure * f**2
    return 1e3 * 20.0 / math.log(10.0) * nepers_per_m


ABSORPTION_LAWS = {"thorp": thorp, "francois_garrison": francois_garrison, "fisher_simmons": fisher_simmons}
