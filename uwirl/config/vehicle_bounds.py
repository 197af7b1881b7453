"""Resolvers of the settings: ${covers:...}, a bound that follows the vehicle; ${drawn:...}, vehicle=random."""

from __future__ import annotations

import math
import random
from typing import Any

from omegaconf import OmegaConf

# Where a bound lies beyond the vehicle's own value, and what part of its thrust a guard may count on.
ROOM, THRUST = 1.1, 0.94
# Factors of vehicle=random on the mass and on the drag of bluerov2.
MASS, DRAG = (0.5, 3.0), (0.2, 10.0)
BLUEROV2 = {
    "mass_kg": [11.5],
    "yaw_inertia": [0.16],
    "added_mass": [5.5, 12.7, 14.57, 0.12],
    "linear_damping": [4.03, 6.22, 5.18, 0.07],
    "quadratic_damping": [18.18, 21.66, 36.99, 1.55],
    "weight_N": [112.8],
}
NET_N = 2.0  # buoyancy less weight, N
FASTER_S = 80.0  # duration of a mission of bluerov2, s
YAW_MOMENT = 26.0  # N m


def covers(bound: str, usual: float, axis: int = 0, *, _root_: Any) -> float:
    """A bound on the vehicle of the settings: the usual one, or what covers the vehicle where that does not.

    Args:
        bound: mass_upper_kg, mass_lower_kg or brake_force_N of the guard, or inertia_lower of a learner.
        usual: its value for vehicles that it covers.
        axis: surge, sway, heave, yaw; of inertia_lower.
    """
    vehicle = _root_.get("vehicle")
    try:
        mass, added, thrust = float(vehicle.mass_kg), list(vehicle.added_mass), list(vehicle.tau_max)
        inertia = [*(mass + x for x in added[:3]), float(vehicle.yaw_inertia) + added[3]]
    except Exception:
        # A vehicle of one's own need not have these, and what is wrong in them is said elsewhere.
        return usual
    if bound == "mass_upper_kg":
        heaviest = max(inertia[:3])
        return usual if heaviest <= usual else float(math.ceil(ROOM * heaviest))
    if bound == "brake_force_N":
        return usual if min(thrust[:2]) >= usual else float(math.floor(THRUST * min(thrust[:2])))
    lightest = min(inertia[:3]) if bound == "mass_lower_kg" else inertia[axis]
    return usual if lightest >= usual else round(lightest / ROOM, 3)


def drawn(seed: int, key: str, axis: int = 0) -> float:
    """A value of vehicle=random: mass and drag of bluerov2 by factors that are log-uniform in MASS and DRAG."""
    draw = random.Random(int(seed))
    heavier, slower = (math.exp(draw.uniform(*map(math.log, factors))) for factors in (MASS, DRAG))
    if key == "duration_s":
        # At the same thrust, speed falls with the root of the drag.
        return float(math.ceil(FASTER_S * max(1.0, math.sqrt(slower)) / 10.0) * 10)
    if key == "dt_s":
        # At full moment, yaw is damped at 2 sqrt(d_rr N_max) / I; a step of Runge-Kutta is stable below 2.78 of that.
        inertia = (BLUEROV2["yaw_inertia"][0] + BLUEROV2["added_mass"][3]) * heavier
        # Learners divide by three steps' worth of inertia at least.
        most = 0.3 * inertia
        most = min(most, 2.5 * inertia / (2.0 * math.sqrt(BLUEROV2["quadratic_damping"][3] * slower * YAW_MOMENT)))
        return next(dt for dt in (0.05, 0.025, 0.0125, 0.00625) if dt < most)
    if key == "buoyancy_N":
        return round(BLUEROV2["weight_N"][0] * heavier, 4) + NET_N
    return round(BLUEROV2[key][axis] * (slower if key.endswith("damping") else heavier), 4)


def register() -> None:
    """Make the resolvers known to OmegaConf."""
    OmegaConf.register_new_resolver("covers", covers, replace=True)
    OmegaConf.register_new_resolver("drawn", drawn, replace=True)
