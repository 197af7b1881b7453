"""Rules of scenario, obstacles, sensors, channel and vehicle."""

from __future__ import annotations

import math

from uwirl.config.checks import AXES, ConfigError, each, finite, one_of, positive, steps
from uwirl.config.schema import (
    ChannelConfig,
    EnergyGuardConfig,
    GuardConfig,
    SafetyConfig,
    ScenarioConfig,
    VehicleConfig,
)

# Of the real axis that classical RK4 integrates stably, |lambda dt| < 2.785.
RK4_STABILITY = 2.785
# Those of uwirl.world.absorption and uwirl.world.layouts, which need torch; a test compares them.
ABSORPTION = ("none", "thorp", "francois_garrison", "fisher_simmons")
# Where the absorption laws were measured.
WATER = {"temperature_C": (-2.0, 35.0), "salinity_ppt": (0.0, 45.0), "depth_m": (0.0, 11_000.0), "pH": (7.0, 9.0)}
LAYOUT_KINDS = ("sparse", "random", "overlapping", "dead_end", "ring", "moving")


def check_scenario(scenario: ScenarioConfig) -> None:
    finite(scenario.source_m, "scenario.source_m", 3)
    finite(scenario.destination_m, "scenario.destination_m", 3)
    if math.dist(scenario.source_m, scenario.destination_m) < 1e-6:
        raise ConfigError("scenario.destination_m", "coincides with scenario.source_m: the link has no length")
    if not scenario.start:
        raise ConfigError("scenario.start", "needs at least one vehicle [x, y, z, psi]")
    for i, eta in enumerate(scenario.start):
        key = f"scenario.start[{i}]"
        finite(eta, key, 4)
        others = {"the source": scenario.source_m, "the destination": scenario.destination_m}
        others |= {f"vehicle {j}": other[:3] for j, other in enumerate(scenario.start[:i])}
        for name, position in others.items():
            if math.dist(eta[:3], position) < 1e-6:
                raise ConfigError(key, f"{eta[:3]} coincides with {name}, where the SNR is infinite; move it away")
    positive(scenario.depth_m, "scenario.depth_m")
    for key, places in (
        ("source_m", [scenario.source_m]),
        ("destination_m", [scenario.destination_m]),
        ("start", scenario.start),
    ):
        for place in places:
            if not -scenario.depth_m <= place[2] <= 0.0:
                raise ConfigError(
                    f"scenario.{key}",
                    f"{place[:3]} is not in the water, -{scenario.depth_m:g} <= z <= 0 (scenario.depth_m)",
                )
    positive(scenario.dt_s, "scenario.dt_s")
    steps(scenario.duration_s, scenario.dt_s, "scenario.duration_s")
    positive(scenario.vehicle_radius_m, "scenario.vehicle_radius_m")
    if not scenario.hearing_range_m > 0.0:
        raise ConfigError("scenario.hearing_range_m", f"must be greater than 0, got {scenario.hearing_range_m:g}")
    steps(scenario.message_period_s, scenario.dt_s, "scenario.message_period_s")
    check_sensors(scenario)


def check_obstacles(scenario: ScenarioConfig, safety: SafetyConfig) -> None:
    """Well-formed, and neither on a start nor on a target, with the guard's margin."""
    margin = safety.margin_m if isinstance(safety, GuardConfig) else 0.0
    occupied = {f"the start of vehicle {i}": eta for i, eta in enumerate(scenario.start)}
    hops = len(scenario.start) + 1
    for i in range(1, hops):
        ends = zip(scenario.source_m, scenario.destination_m, strict=True)
        occupied[f"the target of vehicle {i - 1}"] = [a + i / hops * (b - a) for a, b in ends]
    for i, obstacle in enumerate(scenario.obstacles):
        key = f"scenario.obstacles[{i}]"
        finite(obstacle.center_m, f"{key}.center_m", 2)
        finite(obstacle.velocity_mps, f"{key}.velocity_mps", 2)
        positive(obstacle.radius_m, f"{key}.radius_m")
        if not obstacle.influence_m > obstacle.radius_m:
            raise ConfigError(f"{key}.influence_m", f"must exceed radius_m = {obstacle.radius_m:g}")
        for name, position in occupied.items():
            gap = math.dist(position[:2], obstacle.center_m) - obstacle.radius_m - scenario.vehicle_radius_m
            if gap < margin:
                raise ConfigError(key, f"leaves {gap:.3g} m to {name}, the guard needs {margin:g} m; move one of them")


def check_current(scenario: ScenarioConfig, vehicle: VehicleConfig) -> None:
    """Finite, and weak enough for every thruster to hold against it."""
    finite(scenario.current_mps, "scenario.current_mps", 3)
    positive(scenario.current_std_mps, "scenario.current_std_mps", zero=True)
    positive(scenario.current_time_s, "scenario.current_time_s")
    drag = current_drag_N(scenario, vehicle)
    if drag >= min(vehicle.tau_max[:3]):
        raise ConfigError(
            "scenario.current_mps", f"drags with up to {drag:.3g} N, more than vehicle.tau_max can hold against"
        )


def current_speed(scenario: ScenarioConfig) -> float:
    """Largest, m/s, the Gauss-Markov part taken at three standard deviations."""
    layouts = scenario.layouts.current_mps if scenario.layouts else 0.0
    return math.hypot(*scenario.current_mps) + layouts + 3.0 * scenario.current_std_mps


def current_drag_N(scenario: ScenarioConfig, vehicle: VehicleConfig) -> float:
    """Largest drag of the current on a resting vehicle, N."""
    speed = current_speed(scenario)
    return max(
        linear * speed + quadratic * speed**2
        for linear, quadratic in zip(vehicle.linear_damping[:3], vehicle.quadratic_damping[:3], strict=True)
    )


def check_detection(scenario: ScenarioConfig, vehicle: VehicleConfig, safety: SafetyConfig) -> None:
    """An obstacle must be seen before it is too late to brake, at the terminal speed of full thrust."""
    if not scenario.detection_range_m > 0.0:
        raise ConfigError("scenario.detection_range_m", f"must be greater than 0, got {scenario.detection_range_m:g}")
    if not isinstance(safety, EnergyGuardConfig):
        return
    linear, quadratic = min(vehicle.linear_damping[:2]), min(vehicle.quadratic_damping[:2])
    thrust = math.hypot(*vehicle.tau_max[:2])
    speed = (math.sqrt(linear**2 + 4.0 * quadratic * thrust) - linear) / (2.0 * quadratic)
    speed += current_speed(scenario)
    speed += max((math.hypot(*obstacle.velocity_mps) for obstacle in scenario.obstacles), default=0.0)
    braking = safety.margin_m + speed * scenario.dt_s + safety.mass_upper_kg * speed**2 / (2.0 * safety.brake_force_N)
    if scenario.detection_range_m < braking:
        raise ConfigError(
            "scenario.detection_range_m",
            f"{scenario.detection_range_m:g} m is less than the {braking:.3g} m in which {speed:.3g} m/s is braked",
        )


def check_layouts(scenario: ScenarioConfig) -> None:
    layouts = scenario.layouts
    if layouts is None:
        return
    if layouts.count < 1:
        raise ConfigError("scenario.layouts.count", f"must be at least 1, got {layouts.count}")
    if not 0 <= layouts.seed < 2**63:
        raise ConfigError("scenario.layouts.seed", f"must lie in [0, 2^63), got {layouts.seed}")
    if not layouts.kinds:
        raise ConfigError("scenario.layouts.kinds", f"needs at least one of {', '.join(LAYOUT_KINDS)}")
    for kind in layouts.kinds:
        one_of(kind, "scenario.layouts.kinds", LAYOUT_KINDS)
    positive(layouts.half_width_m, "scenario.layouts.half_width_m")
    positive(layouts.current_mps, "scenario.layouts.current_mps", zero=True)


def check_sensors(scenario: ScenarioConfig) -> None:
    key, sensors = "scenario.sensors", scenario.sensors
    if isinstance(sensors, int) and not isinstance(sensors, bool):
        if sensors < 3:
            raise ConfigError(key, f"{sensors} sensors cannot determine K, n and the fading: at least 3 are needed")
        return
    if not isinstance(sensors, list):
        raise ConfigError(key, f"must be a number or a list of positions [x, y, z], got {sensors!r}")
    if len(sensors) < 3:
        raise ConfigError(key, f"{len(sensors)} sensors cannot determine K, n and the fading: at least 3 are needed")
    for i, sensor in enumerate(sensors):
        finite(sensor, f"{key}[{i}]", 3)
    nodes = {"the source": scenario.source_m, "the destination": scenario.destination_m}
    nodes |= {f"vehicle {i}": eta[:3] for i, eta in enumerate(scenario.start)}
    for j, sensor in enumerate(sensors):
        for name, position in nodes.items():
            if math.dist(position, sensor) < 1e-6:
                raise ConfigError(f"{key}[{j}]", f"lies on {name}, where the SNR is infinite; move it away")
    for i, eta in enumerate(scenario.start):
        distances = [math.dist(eta[:3], sensor) for sensor in sensors]
        if max(distances) / min(distances) < 1.0 + 1e-9:
            raise ConfigError(
                key,
                f"all {len(sensors)} sensors are {distances[0]:g} m from vehicle {i}: K and n cannot be told apart "
                "from one distance; spread them",
            )


def check_channel(channel: ChannelConfig) -> None:
    for name in ("K_dB", "N0_dB"):
        if not math.isfinite(getattr(channel, name)):
            raise ConfigError(f"channel.{name}", "must be finite")
    positive(channel.n, "channel.n")
    positive(channel.bandwidth_khz, "channel.bandwidth_khz")
    positive(channel.rho_dB, "channel.rho_dB", zero=True)
    positive(channel.zeta_dB, "channel.zeta_dB", zero=True)
    positive(channel.varphi_m, "channel.varphi_m")
    one_of(channel.absorption, "channel.absorption", ABSORPTION)
    if channel.absorption == "none" and channel.frequency_khz is not None:
        raise ConfigError("channel.frequency_khz", "has no effect without absorption; set channel.absorption=thorp too")
    for key, (low, high) in WATER.items():
        value = getattr(channel.water, key)
        if not low <= value <= high:
            raise ConfigError(f"channel.water.{key}", f"must lie in [{low:g}, {high:g}], got {value:g}")
    if channel.absorption != "none":
        if channel.frequency_khz is None:
            raise ConfigError("channel.frequency_khz", f"absorption {channel.absorption} needs a frequency in kHz")
        positive(channel.frequency_khz, "channel.frequency_khz")


def check_vehicle(vehicle: VehicleConfig, dt: float) -> None:
    positive(vehicle.mass_kg, "vehicle.mass_kg")
    positive(vehicle.yaw_inertia, "vehicle.yaw_inertia")
    each(vehicle.added_mass, "vehicle.added_mass", 4, zero=True)
    each(vehicle.linear_damping, "vehicle.linear_damping", 4, zero=True)
    each(vehicle.quadratic_damping, "vehicle.quadratic_damping", 4)
    each(vehicle.tau_max, "vehicle.tau_max", 4)
    positive(vehicle.weight_N, "vehicle.weight_N", zero=True)
    positive(vehicle.buoyancy_N, "vehicle.buoyancy_N", zero=True)
    trim = abs(vehicle.weight_N - vehicle.buoyancy_N)
    if trim >= vehicle.tau_max[2]:
        raise ConfigError("vehicle.tau_max", f"heave {vehicle.tau_max[2]:g} N cannot hold the net weight of {trim:g} N")
    rigid = [vehicle.mass_kg] * 3 + [vehicle.yaw_inertia]
    for axis, r, added, linear, quadratic, limit in zip(
        AXES,
        rigid,
        vehicle.added_mass,
        vehicle.linear_damping,
        vehicle.quadratic_damping,
        vehicle.tau_max,
        strict=True,
    ):
        # Damping at terminal speed under full thrust: d/dv (linear v + quadratic v^2).
        rate = math.sqrt(linear**2 + 4.0 * quadratic * limit) / (r + added)
        if rate * dt > RK4_STABILITY:
            raise ConfigError(
                "scenario.dt_s",
                f"{dt:g} s cannot be integrated stably: {axis} is damped at {rate:.3g} 1/s at full thrust, so "
                f"dt_s must stay below {RK4_STABILITY / rate:.3g} s",
            )
