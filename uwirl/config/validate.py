"""Rules that a composed configuration must obey. Knows no torch: it answers before anything heavy is imported.

Rules of one section stand with its schema, those between sections here.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

from uwirl.config.checks import AXES, ConfigError, in_steps
from uwirl.config.custom import check_targets
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.motion_schema import (
    BasisName,
    EnergyGuardConfig,
    GeodesicConfig,
    GuardConfig,
    IdentifiedConfig,
    IrlConfig,
    MissionsConfig,
    PdConfig,
    TrajectoryOptimizationConfig,
    VirtualLinksConfig,
)
from uwirl.config.schema import Config, InitPart
from uwirl.config.world_schema import ScenarioConfig, VehicleConfig

# Of the real axis that classical RK4 integrates stably, |lambda dt| < 2.785.
RK4_STABILITY = 2.785
# Of all vehicles' route maps: 4 million nodes take about 2 GB while it is solved.
MAX_NODES = 4_000_000
# Below, the weakest damping that the bounds ask for would already ring under a control held for dt.
LEAST_INERTIA_PER_S = (4.0, 4.0, 4.0, 3.0)

__all__ = ["ConfigError", "validate", "validate_estimate"]

# A key, and what is wrong with it. The first is raised, so what comes later may rely on it.
Problems = Iterator[tuple[str, str]]


def validate(config: Config) -> None:
    """Check what `uwirl` is to run: ranges and rules between settings, then classes of the user's own.

    Raises:
        ConfigError: the first rule that is broken.
    """
    learns = isinstance(config.planner, IrlConfig) or isinstance(config.baseline, IrlConfig)
    # Only a learner needs experience.
    checked = config if learns else replace(config, experience=None)  # type: ignore[arg-type]
    checked.check("")
    families = (
        _world(config),
        _chain(config),
        _guard(config),
        _obstacles(config),
        _guidance(config),
        _planner("planner", config.planner, config),
        _planner("baseline", config.baseline, config),
        _geodesic_basis(config),
        _start(config),
        _device(config.device),
        _compiler(config),
    )
    for key, problem in (found for problems in families for found in problems):
        raise ConfigError(key, problem)
    # Last, because it imports what it checks.
    check_targets(config)


def validate_estimate(config: EstimateConfig) -> None:
    """Check what `uwirl-estimate` is to run: ranges, rules between settings, and that the log is a file.

    Raises:
        ConfigError: the first rule that is broken.
    """
    config.check("")
    check_targets(config)


def _world(config: Config) -> Problems:
    """A step that integrates the vehicle stably, a current that it holds against, obstacles seen in time."""
    scenario, vehicle, safety = config.scenario, config.vehicle, config.safety
    rigid = [vehicle.mass_kg] * 3 + [vehicle.yaw_inertia]
    drag = zip(vehicle.linear_damping, vehicle.quadratic_damping, vehicle.tau_max, strict=True)
    for axis, r, added, (linear, quadratic, limit) in zip(AXES, rigid, vehicle.added_mass, drag, strict=True):
        # Damping at terminal speed under full thrust: d/dv (linear v + quadratic v^2).
        rate = math.sqrt(linear**2 + 4.0 * quadratic * limit) / (r + added)
        if rate * scenario.dt_s > RK4_STABILITY:
            damped = f"{axis} is damped at {rate:.3g} 1/s at full thrust"
            problem = f"cannot be integrated stably: {damped}, so dt_s must stay below {RK4_STABILITY / rate:.3g} s"
            yield "scenario.dt_s", f"{scenario.dt_s:g} s {problem}"
    force = current_drag_N(scenario, vehicle)
    if force >= min(vehicle.tau_max[:3]):
        yield "scenario.current_mps", f"drags with up to {force:.3g} N, more than vehicle.tau_max can hold against"
    if isinstance(safety, EnergyGuardConfig):
        speed = _top_speed(scenario, vehicle)
        braking = safety.mass_upper_kg * speed**2 / (2.0 * safety.brake_force_N)
        need = safety.margin_m + speed * scenario.dt_s + braking
        if scenario.detection_range_m < need:
            problem = f"is less than the {need:.3g} m in which {speed:.3g} m/s is braked"
            yield "scenario.detection_range_m", f"{scenario.detection_range_m:g} m {problem}"


def current_speed(scenario: ScenarioConfig) -> float:
    """Largest, m/s, the Gauss-Markov part taken at three standard deviations."""
    layouts = scenario.layouts.current_mps if scenario.layouts else 0.0
    return math.hypot(*scenario.current_mps) + layouts + 3.0 * scenario.current_std_mps


def current_drag_N(scenario: ScenarioConfig, vehicle: VehicleConfig) -> float:
    """Largest drag of the current on a resting vehicle, N."""
    speed = current_speed(scenario)
    damping = zip(vehicle.linear_damping[:3], vehicle.quadratic_damping[:3], strict=True)
    return max(linear * speed + quadratic * speed**2 for linear, quadratic in damping)


def _top_speed(scenario: ScenarioConfig, vehicle: VehicleConfig) -> float:
    """At which a vehicle and an obstacle may meet, m/s: terminal speed of full thrust, current and drift added."""
    linear, quadratic = min(vehicle.linear_damping[:2]), min(vehicle.quadratic_damping[:2])
    thrust = math.hypot(*vehicle.tau_max[:2])
    speed = (math.sqrt(linear**2 + 4.0 * quadratic * thrust) - linear) / (2.0 * quadratic)
    drift = max((math.hypot(*obstacle.velocity_mps) for obstacle in scenario.obstacles), default=0.0)
    return speed + current_speed(scenario) + drift


def _chain(config: Config) -> Problems:
    """Room for all vehicles on the link."""
    scenario, safety = config.scenario, config.safety
    apart, why = 2.0 * scenario.vehicle_radius_m, "2 scenario.vehicle_radius_m"
    if isinstance(safety, GuardConfig) and safety.separation_m > apart:
        apart, why = safety.separation_m, "safety.separation_m"
    length, vehicles = math.dist(scenario.source_m, scenario.destination_m), len(scenario.start)
    hop = length / (vehicles + 1)
    if vehicles > 1 and hop < apart:
        close = f"{hop:.3g} m apart on the link of {length:.3g} m, closer than {why} = {apart:g} m"
        most = max(1, math.floor(length / apart) - 1)
        yield "scenario.start", f"puts the targets of {vehicles} vehicles {close}; {most} would fit"


def _guard(config: Config) -> Problems:
    """What the guarantee rests on: bounds that cover the vehicle, and thrust left for braking."""
    scenario, vehicle, safety = config.scenario, config.vehicle, config.safety
    if not isinstance(safety, GuardConfig):
        return
    for (i, one), (j, other) in combinations(enumerate(scenario.start), 2):
        if math.dist(one[:3], other[:3]) < safety.separation_m:
            problem = f"is closer than safety.separation_m = {safety.separation_m:g} m to vehicle {i}"
            yield f"scenario.start.{j}", problem
    hulls = 2.0 * scenario.vehicle_radius_m
    if len(scenario.start) > 1 and safety.separation_m < hulls:
        yield (
            "safety.separation_m",
            f"{safety.separation_m:g} m is less than two scenario.vehicle_radius_m = {hulls:g} m",
        )
    if isinstance(safety, EnergyGuardConfig):
        if safety.alpha * scenario.dt_s > 1.0:
            yield (
                "safety.alpha",
                f"must be at most 1 / scenario.dt_s = {1.0 / scenario.dt_s:g}: a control is held so long",
            )
        # Nothing is near one vehicle in free water.
        if scenario.obstacles or scenario.layouts or len(scenario.start) > 1:
            yield from _inertia_bounds(safety, guarded_inertia(config))
        thrust = min(vehicle.tau_max[:2])
        if len(scenario.start) > 1:
            thrust = min(thrust, vehicle.tau_max[2] - abs(vehicle.weight_N - vehicle.buoyancy_N))
        thrust -= current_drag_N(scenario, vehicle)
        if safety.brake_force_N > thrust:
            left = "of vehicle.tau_max that weight and current leave for braking"
            yield "safety.brake_force_N", f"exceeds the {thrust:.3g} N {left}"


def guarded_inertia(config: Config) -> dict[str, float]:
    """Mass and added mass by the axes that a guard brakes, kg; heave where there are several vehicles."""
    axes = AXES[: 3 if len(config.scenario.start) > 1 else 2]
    return {axis: config.vehicle.mass_kg + added for axis, added in zip(axes, config.vehicle.added_mass, strict=False)}


def _inertia_bounds(safety: EnergyGuardConfig, inertia: dict[str, float]) -> Problems:
    heavy, light = max(inertia, key=inertia.__getitem__), min(inertia, key=inertia.__getitem__)
    void = "added mass included, so that the guard guarantees nothing; set"
    if inertia[heavy] > safety.mass_upper_kg:
        problem = f"{safety.mass_upper_kg:g} kg is less than the vehicle's {inertia[heavy]:g} kg in {heavy}, {void}"
        yield "safety.mass_upper_kg", f"{problem} safety.mass_upper_kg={math.ceil(1.1 * inertia[heavy])}"
    if inertia[light] < safety.mass_lower_kg:
        problem = f"{safety.mass_lower_kg:g} kg is more than the vehicle's {inertia[light]:g} kg in {light}, {void}"
        yield "safety.mass_lower_kg", f"{problem} safety.mass_lower_kg={0.9 * inertia[light]:.2g}"


def _obstacles(config: Config) -> Problems:
    """Neither on a start nor on a target, with the guard's margin."""
    scenario = config.scenario
    margin = config.safety.margin_m if isinstance(config.safety, GuardConfig) else 0.0
    occupied = {f"the start of vehicle {i}": eta for i, eta in enumerate(scenario.start, 1)}
    hops = len(scenario.start) + 1
    for i in range(1, hops):
        ends = zip(scenario.source_m, scenario.destination_m, strict=True)
        occupied[f"the target of vehicle {i}"] = [a + i / hops * (b - a) for a, b in ends]
    for i, obstacle in enumerate(scenario.obstacles):
        for name, position in occupied.items():
            gap = math.dist(position[:2], obstacle.center_m) - obstacle.radius_m - scenario.vehicle_radius_m
            if gap < margin:
                problem = f"leaves {gap:.3g} m to {name}, the guard needs {margin:g} m; move one of them"
                yield f"scenario.obstacles.{i}", problem


def _guidance(config: Config) -> Problems:
    """Maps that memory holds."""
    guidance, scenario = config.guidance, config.scenario
    planners = (config.planner, config.baseline)
    # One vehicle in free and still water is guided straight, unless a basis or an optimiser uses the map.
    mapped = (
        scenario.obstacles
        or len(scenario.start) > 1
        or scenario.layouts
        or current_speed(scenario) > 0.0
        or config.basis.name == BasisName.geodesic
        or any(isinstance(planner, TrajectoryOptimizationConfig) for planner in planners)
    )
    if isinstance(guidance, GeodesicConfig) and mapped:
        places = [scenario.source_m, scenario.destination_m, *scenario.start, *(o.center_m for o in scenario.obstacles)]
        sides = [max(p[axis] for p in places) - min(p[axis] for p in places) for axis in (0, 1)]
        nodes = math.prod(side / guidance.spacing_m for side in sides) * len(scenario.start)
        if nodes > MAX_NODES:
            least = 1.01 * guidance.spacing_m * math.sqrt(nodes / MAX_NODES)
            right = f"choose at least {least:.2g} m, or guidance=straight"
            problem = f"makes maps of {nodes:,.0f} nodes, of which memory holds {MAX_NODES:,}; {right}"
            yield "guidance.spacing_m", problem


def _planner(key: str, planner: Any, config: Config) -> Problems:
    """Times in whole steps, and what else a planner needs of other sections."""
    dt = config.scenario.dt_s
    if isinstance(planner, (IrlConfig, IdentifiedConfig, PdConfig)):
        problem = in_steps(planner.calibration_s, dt, least=4)
        if problem:
            yield f"{key}.calibration_s", problem
    if isinstance(planner, TrajectoryOptimizationConfig):
        for family in ("vehicle", "channel"):
            section = getattr(config, family)
            if section.target not in (None, type(section).target):
                yield f"{key}.name", f"plans with the equations of uwirl's own {family}, not of {family}.target"
    if isinstance(planner, IdentifiedConfig):
        yield from _identifier(key, planner, config)
    if isinstance(planner, IrlConfig):
        yield from _learner(key, planner, config)


def _identifier(key: str, planner: IdentifiedConfig, config: Config) -> Problems:
    dt, experience = config.scenario.dt_s, config.experience
    times = [(f"{key}.window_s", planner.window_s), (f"{key}.replan_s", planner.replan_s)]
    for name, seconds in (*times, ("experience.leg_s", experience.leg_s)):
        problem = in_steps(seconds, dt, 1)
        if problem:
            yield name, problem
    if planner.node_s < dt:
        yield f"{key}.node_s", f"must be at least scenario.dt_s = {dt:g}, got {planner.node_s:g}"
    hovers = not isinstance(experience, MissionsConfig)
    if hovers and planner.max_time_s < planner.calibration_s + experience.leg_s:
        yield f"{key}.max_time_s", f"{planner.max_time_s:g} s is shorter than the calibration hover and one leg"
    if not isinstance(config.guidance, GeodesicConfig):
        yield "guidance.name", "planner=identified plans along the ways of guidance=geodesic"


def _learner(key: str, planner: IrlConfig, config: Config) -> Problems:
    dt, experience = config.scenario.dt_s, config.experience
    window = round(planner.window_s / dt)
    times = [(f"{key}.window_s", planner.window_s, 2), (f"{key}.stride_s", planner.stride_s, 1)]
    times += [(f"{key}.model_window_s", planner.model_window_s, 1)]
    for name, seconds, least in (*times, ("experience.leg_s", experience.leg_s, 1)):
        problem = in_steps(seconds, dt, least)
        if problem:
            yield name, problem
    if window % 2:
        problem = f"must be an even number of steps for Simpson's rule, got {window} x {dt:g} s"
        yield f"{key}.window_s", problem
    for axis, inertia, share in zip(AXES, planner.inertia_lower, LEAST_INERTIA_PER_S, strict=True):
        if inertia < share * dt:
            yield f"{key}.inertia_lower", f"{axis} must be at least {share * dt:.3g}, got {inertia:g}"
    if experience.leg_s < max(planner.window_s, planner.model_window_s):
        yield "experience.leg_s", f"{experience.leg_s:g} s is shorter than planner.window_s or model_window_s"
    hovers = not isinstance(experience, MissionsConfig)
    if hovers and planner.max_time_s < planner.calibration_s + experience.leg_s:
        yield f"{key}.max_time_s", f"{planner.max_time_s:g} s is shorter than the calibration hover and one leg"


def _geodesic_basis(config: Config) -> Problems:
    if config.basis.name == BasisName.geodesic and isinstance(config.planner, IrlConfig):
        if not isinstance(config.guidance, GeodesicConfig):
            yield "guidance.name", "basis=geodesic learns how to fly with guidance=geodesic"
        if isinstance(config.experience, VirtualLinksConfig) and config.experience.relabel:
            yield "experience.relabel", "must be 0 with basis=geodesic: another link needs another map"
        if isinstance(config.experience, MissionsConfig):
            yield "experience.name", "basis=geodesic learns from experience=virtual_links or parallel"


def _start(config: Config) -> Problems:
    """What is taken over must be of use."""
    weights = InitPart.weights in config.init_from_parts and config.init_from is not None
    if weights and not isinstance(config.planner, IrlConfig):
        yield "init_from_parts", f"planner={config.planner.name} has no weights; choose [estimate]"


def _compiler(config: Config) -> Problems:
    if config.compile and config.device == "cpu" and not shutil.which(os.environ.get("CXX", "g++")):
        yield "compile", "needs a C++ compiler, g++ or the one that the variable CXX names; there is none"


def _device(name: str) -> Problems:
    """What is there is known by torch alone."""
    if name == "cpu":
        return
    import torch

    kind, _, number = name.partition(":")
    there = torch.backends.mps.is_available() if kind == "mps" else torch.cuda.is_available()
    if not there:
        yield "device", f"{name} is not there (no {kind.upper()} device that this PyTorch can use); choose device=cpu"
    elif number and int(number) >= torch.cuda.device_count():
        yield "device", f"{name} is not there, of {torch.cuda.device_count()} from cuda:0; choose one, or device=cpu"
