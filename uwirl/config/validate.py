"""Rules that a composed configuration must obey. Knows no torch: it answers before anything heavy is imported."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any

from uwirl.config.schema import (
    ChannelConfig,
    Config,
    CostConfig,
    ExperienceConfig,
    IrlConfig,
    LeastSquaresSolverConfig,
    ParallelConfig,
    PdConfig,
    PlannerConfig,
    RlsSolverConfig,
    ScenarioConfig,
    SolverConfig,
    VehicleConfig,
    VirtualLinksConfig,
)

AXES = ("surge", "sway", "heave", "yaw")
# Of the real axis that classical RK4 integrates stably, |lambda dt| < 2.785.
RK4_STABILITY = 2.785
MAX_STEPS = 1_000_000
# Batch solvers by name, and whether each is bounded.
BATCH = {"batch": False, "bounded_batch": True}


class ConfigError(ValueError):
    """One impossible setting.

    Args:
        key: where, as on the command line.
        problem: what is wrong, and what would be right.
    """

    def __init__(self, key: str, problem: str):
        super().__init__(f"{key}: {problem}")
        self.key = key


def _positive(value: float, key: str, zero: bool = False) -> None:
    if not (math.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
        raise ConfigError(key, f"must be {'at least 0' if zero else 'greater than 0'}, got {value:g}")


def _each(values: Sequence[float], key: str, length: int, zero: bool = False) -> None:
    """`length` numbers, all positive (or zero)."""
    _finite(values, key, length)
    for value, axis in zip(values, AXES, strict=True):
        if value < 0.0 or (value == 0.0 and not zero):
            raise ConfigError(key, f"{axis} must be {'at least 0' if zero else 'greater than 0'}, got {value:g}")


def _finite(values: Any, key: str, length: int) -> None:
    numbers = isinstance(values, list) and all(isinstance(v, (int, float)) and math.isfinite(v) for v in values)
    if not numbers or len(values) != length:
        raise ConfigError(key, f"needs {length} finite numbers, got {values}")


def _one_of(value: str, key: str, choices: Iterable[str]) -> None:
    choices = list(choices)
    if value not in choices:
        near = difflib.get_close_matches(value, choices, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ConfigError(key, f"{value!r} is none of {', '.join(choices)}{hint}")


def _named(value: str, key: str, family: Iterable[str], here: Iterable[str]) -> None:
    """A name of the family, and one that belongs to the settings it stands in."""
    _one_of(value, key, family)
    if value not in here:
        group = key.removesuffix(".name")
        raise ConfigError(key, f"{value!r} needs other settings than these; choose it with {group}={value}")


def _steps(seconds: float, dt: float, key: str, least: int = 1) -> int:
    """How many steps a time is, which must be whole."""
    _positive(seconds, key)
    if seconds / dt > MAX_STEPS:
        raise ConfigError(key, f"{seconds:g} s are more than {MAX_STEPS:,} steps of scenario.dt_s = {dt:g} s")
    steps = round(seconds / dt)
    if steps < least:
        raise ConfigError(key, f"{seconds:g} s is shorter than {least} steps of scenario.dt_s = {dt:g} s")
    if abs(steps * dt - seconds) > 1e-9:
        raise ConfigError(key, f"{seconds:g} s is no whole number of steps of scenario.dt_s = {dt:g} s")
    return steps


def _scenario(scenario: ScenarioConfig) -> None:
    _finite(scenario.source_m, "scenario.source_m", 3)
    _finite(scenario.destination_m, "scenario.destination_m", 3)
    if math.dist(scenario.source_m, scenario.destination_m) < 1e-6:
        raise ConfigError("scenario.destination_m", "coincides with scenario.source_m: the link has no length")
    if not scenario.start:
        raise ConfigError("scenario.start", "needs at least one vehicle [x, y, z, psi]")
    for i, eta in enumerate(scenario.start):
        key = f"scenario.start[{i}]"
        _finite(eta, key, 4)
        others = {"the source": scenario.source_m, "the destination": scenario.destination_m}
        others |= {f"vehicle {j}": other[:3] for j, other in enumerate(scenario.start[:i])}
        for name, position in others.items():
            if math.dist(eta[:3], position) < 1e-6:
                raise ConfigError(key, f"{eta[:3]} coincides with {name}, where the SNR is infinite; move it away")
    _positive(scenario.dt_s, "scenario.dt_s")
    _steps(scenario.duration_s, scenario.dt_s, "scenario.duration_s")
    _sensors(scenario)


def _sensors(scenario: ScenarioConfig) -> None:
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
        _finite(sensor, f"{key}[{i}]", 3)
    for i, eta in enumerate(scenario.start):
        distances = [math.dist(eta[:3], sensor) for sensor in sensors]
        if min(distances) < 1e-6:
            j = distances.index(min(distances))
            raise ConfigError(f"{key}[{j}]", f"lies on vehicle {i}, where the SNR is infinite; move it away")
        if max(distances) / min(distances) < 1.0 + 1e-9:
            raise ConfigError(
                key,
                f"all {len(sensors)} sensors are {distances[0]:g} m from vehicle {i}: K and n cannot be told apart "
                "from one distance; spread them",
            )


def _channel(channel: ChannelConfig) -> None:
    for name in ("K_dB", "N0_dB"):
        if not math.isfinite(getattr(channel, name)):
            raise ConfigError(f"channel.{name}", "must be finite")
    _positive(channel.n, "channel.n")
    _positive(channel.bandwidth_khz, "channel.bandwidth_khz")
    _positive(channel.rho_dB, "channel.rho_dB", zero=True)
    _one_of(channel.absorption, "channel.absorption", ("none", "thorp"))
    if channel.absorption == "none" and channel.frequency_khz is not None:
        raise ConfigError("channel.frequency_khz", "has no effect without absorption; set channel.absorption=thorp too")
    if channel.absorption != "none":
        if channel.frequency_khz is None:
            raise ConfigError("channel.frequency_khz", f"absorption {channel.absorption} needs a frequency in kHz")
        _positive(channel.frequency_khz, "channel.frequency_khz")


def _vehicle(vehicle: VehicleConfig, dt: float) -> None:
    _positive(vehicle.mass_kg, "vehicle.mass_kg")
    _positive(vehicle.yaw_inertia, "vehicle.yaw_inertia")
    _each(vehicle.added_mass, "vehicle.added_mass", 4, zero=True)
    _each(vehicle.linear_damping, "vehicle.linear_damping", 4, zero=True)
    _each(vehicle.quadratic_damping, "vehicle.quadratic_damping", 4)
    _each(vehicle.tau_max, "vehicle.tau_max", 4)
    _positive(vehicle.weight_N, "vehicle.weight_N", zero=True)
    _positive(vehicle.buoyancy_N, "vehicle.buoyancy_N", zero=True)
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


def _cost(cost: CostConfig) -> None:
    _positive(cost.beta_1, "cost.beta_1")
    _positive(cost.yaw_weight, "cost.yaw_weight", zero=True)
    _finite(cost.R, "cost.R", 4)
    if min(cost.R) <= 0.0:
        raise ConfigError("cost.R", f"must be positive definite, that is all four greater than 0, got {cost.R}")


def _solver(solver: SolverConfig) -> None:
    rls = ("rls_paper", "rls_forgetting")
    least_squares = ("z_rls", *BATCH)
    here = rls if isinstance(solver, RlsSolverConfig) else least_squares
    _named(solver.name, "solver.name", (*least_squares, *rls), here)
    if isinstance(solver, LeastSquaresSolverConfig):
        if solver.name in BATCH and solver.bounded != BATCH[solver.name]:
            raise ConfigError(
                "solver.bounded", "says otherwise than the solver's name; choose solver=batch or bounded_batch"
            )
        _positive(solver.ridge, "solver.ridge", zero=True)
        _positive(solver.prior, "solver.prior", zero=True)
    if isinstance(solver, RlsSolverConfig):
        _positive(solver.kappa, "solver.kappa")
        _positive(solver.p0, "solver.p0")
        if solver.name == "rls_forgetting" and solver.kappa > 1.0:
            raise ConfigError("solver.kappa", f"a forgetting factor lies in (0, 1], got {solver.kappa:g}")


def _experience(experience: ExperienceConfig, planner: IrlConfig, dt: float) -> None:
    here = "parallel" if isinstance(experience, ParallelConfig) else "virtual_links"
    _named(experience.name, "experience.name", ("virtual_links", "parallel"), [here])
    _steps(experience.leg_s, dt, "experience.leg_s")
    if experience.leg_s < planner.window_s:
        raise ConfigError("experience.leg_s", f"{experience.leg_s:g} s is shorter than planner.window_s")
    _each(experience.excitation_rms, "experience.excitation_rms", 4)
    for name in ("excitation_strength", "excitation_band_rad_s"):
        low_high = getattr(experience, name)
        _finite(low_high, f"experience.{name}", 2)
        if not 0.0 <= low_high[0] <= low_high[1]:
            raise ConfigError(f"experience.{name}", f"must be [low, high] with 0 <= low <= high, got {low_high}")
    for name in ("across_share", "up_m", "yaw_rad", "near_scale"):
        _positive(getattr(experience, name), f"experience.{name}")
    if not 0.0 <= experience.near_share <= 1.0:
        raise ConfigError("experience.near_share", f"is a share between 0 and 1, got {experience.near_share:g}")
    if isinstance(experience, VirtualLinksConfig):
        if experience.relabel < 0:
            raise ConfigError("experience.relabel", f"must be at least 0, got {experience.relabel}")
        _positive(experience.relabel_time_s, "experience.relabel_time_s")
    if isinstance(experience, ParallelConfig) and experience.worlds < 1:
        raise ConfigError("experience.worlds", f"must be at least 1, got {experience.worlds}")


def _planner(planner: PlannerConfig, group: str, config: Config) -> None:
    dt = config.scenario.dt_s
    _named(planner.name, f"{group}.name", ("irl", "pd"), ["irl" if isinstance(planner, IrlConfig) else "pd"])
    _steps(planner.calibration_s, dt, f"{group}.calibration_s", least=4)
    if len(config.scenario.start) != 1:
        raise ConfigError("scenario.start", f"planners fly one vehicle so far, got {len(config.scenario.start)}")
    if isinstance(planner, PdConfig):
        _each(planner.position_gain, f"{group}.position_gain", 4)
        _each(planner.velocity_gain, f"{group}.velocity_gain", 4)
        _positive(planner.saturation_m, f"{group}.saturation_m")
    if isinstance(planner, IrlConfig):
        window = _steps(planner.window_s, dt, f"{group}.window_s", least=2)
        if window % 2:
            raise ConfigError(
                f"{group}.window_s", f"must be an even number of steps for Simpson's rule, got {window} x {dt:g} s"
            )
        _steps(planner.stride_s, dt, f"{group}.stride_s")
        _positive(planner.residual_floor, f"{group}.residual_floor")
        if planner.updates < 1:
            raise ConfigError(f"{group}.updates", f"must be at least 1, got {planner.updates}")
        _one_of(planner.actor_sign, f"{group}.actor_sign", ("corrected", "printed"))
        _each(planner.inertia_lower, f"{group}.inertia_lower", 4)
        # Below, the weakest damping that the bounds ask for would already ring under a control held for dt.
        for axis, inertia, least in zip(AXES, planner.inertia_lower, (4.0, 4.0, 4.0, 3.0), strict=True):
            if inertia < least * dt:
                raise ConfigError(
                    f"{group}.inertia_lower", f"{axis} must be at least {least * dt:.3g}, got {inertia:g}"
                )
        _positive(planner.tolerance_weights, f"{group}.tolerance_weights", zero=True)
        _positive(planner.tolerance_inverse_capacity, f"{group}.tolerance_inverse_capacity", zero=True)
        _experience(config.experience, planner, dt)
        _positive(planner.max_time_s, f"{group}.max_time_s")
        if not math.isfinite(planner.start_gain):
            raise ConfigError(f"{group}.start_gain", f"must be finite, got {planner.start_gain}")
        if planner.max_time_s < planner.calibration_s + config.experience.leg_s:
            raise ConfigError(
                f"{group}.max_time_s", f"{planner.max_time_s:g} s is shorter than the calibration hover and one leg"
            )


def validate(config: Config) -> None:
    """Check ranges and cross-field rules.

    Raises:
        ConfigError: the first rule that is broken.
    """
    _scenario(config.scenario)
    _channel(config.channel)
    _vehicle(config.vehicle, config.scenario.dt_s)
    _one_of(config.estimator.name, "estimator.name", ("least_squares", "oracle"))
    _one_of(config.basis.name, "basis.name", ("link_frame", "error_quadratic", "error_velocity"))
    if config.basis.name == "link_frame":
        scales = config.basis.length_scales_m
        if not scales or any(not L > 0.0 for L in scales) or len(set(scales)) < len(scales):
            raise ConfigError("basis.length_scales_m", f"needs one or more different positive lengths, got {scales}")
    _cost(config.cost)
    _solver(config.solver)
    _planner(config.planner, "planner", config)
    _planner(config.baseline, "baseline", config)
    if config.threads < 1:
        raise ConfigError("threads", f"must be at least 1, got {config.threads}")
    if not 0 <= config.seed < 2**63:
        raise ConfigError("seed", f"must lie in [0, 2^63), got {config.seed}")
    _one_of(config.device.split(":")[0], "device", ("cpu", "cuda", "mps"))
    _one_of(config.dtype, "dtype", ("float64", "float32"))
