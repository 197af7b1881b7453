"""Rules of cost, guard, solver, experience and planner."""

from __future__ import annotations

import math
from itertools import combinations

from uwirl.config.checks import AXES, ConfigError, each, finite, named, one_of, positive, steps
from uwirl.config.schema import (
    BarrierGuardConfig,
    Config,
    CostConfig,
    EnergyGuardConfig,
    ExperienceConfig,
    GeodesicConfig,
    GuardConfig,
    GuidanceConfig,
    IrlConfig,
    LeastSquaresSolverConfig,
    OwnPlannerConfig,
    ParallelConfig,
    PdConfig,
    PlannerConfig,
    PotentialFieldConfig,
    PrintedCostConfig,
    RlsSolverConfig,
    SafetyConfig,
    ScenarioConfig,
    SolverConfig,
    TrajectoryOptimizationConfig,
    VirtualLinksConfig,
)
from uwirl.config.world_rules import current_drag_N

# Of all vehicles' route maps: 4 million nodes take about 2 GB while it is solved.
MAX_NODES = 4_000_000
# Batch solvers by name, and whether each is bounded.
BATCH = {"batch": False, "bounded_batch": True}


def check_cost(cost: CostConfig) -> None:
    positive(cost.beta_1, "cost.beta_1")
    positive(cost.beta_2, "cost.beta_2", zero=True)
    positive(cost.yaw_weight, "cost.yaw_weight", zero=True)
    here = "printed" if isinstance(cost, PrintedCostConfig) else "smooth"
    named(cost.avoidance, "cost.avoidance", ("smooth", "printed"), [here])
    if isinstance(cost, PrintedCostConfig):
        if not 0.0 < cost.left_m < cost.right_m:
            raise ConfigError("cost.left_m", f"must lie between 0 and right_m = {cost.right_m:g}, got {cost.left_m:g}")
        if not 0.0 < cost.kappa_2 < cost.kappa_1 < 1.0:
            raise ConfigError("cost.kappa_1", "needs 0 < kappa_2 < kappa_1 < 1 (Remark 2)")
    finite(cost.R, "cost.R", 4)
    if min(cost.R) <= 0.0:
        raise ConfigError("cost.R", f"must be positive definite, that is all four greater than 0, got {cost.R}")


def check_safety(safety: SafetyConfig, config: Config) -> None:
    guards = {EnergyGuardConfig: "energy", BarrierGuardConfig: "barrier"}
    named(safety.name, "safety.name", ("energy", "barrier", "none"), [guards.get(type(safety), "none")])
    if isinstance(safety, GuardConfig):
        positive(safety.margin_m, "safety.margin_m", zero=True)
        positive(safety.separation_m, "safety.separation_m")
        start = config.scenario.start
        for (i, one), (j, other) in combinations(enumerate(start), 2):
            if math.dist(one[:3], other[:3]) < safety.separation_m:
                raise ConfigError(
                    f"scenario.start[{j}]",
                    f"is closer than safety.separation_m = {safety.separation_m:g} m to vehicle {i}",
                )
    if isinstance(safety, BarrierGuardConfig):
        positive(safety.k_1, "safety.k_1")
        positive(safety.k_0, "safety.k_0")
        finite(safety.inertia_kg, "safety.inertia_kg", 3)
        if min(safety.inertia_kg) <= 0.0:
            raise ConfigError("safety.inertia_kg", f"must be greater than 0 on each axis, got {safety.inertia_kg}")
    if isinstance(safety, EnergyGuardConfig):
        for name in ("alpha", "mass_lower_kg", "mass_upper_kg", "brake_force_N"):
            positive(getattr(safety, name), f"safety.{name}")
        if safety.mass_upper_kg < safety.mass_lower_kg:
            raise ConfigError("safety.mass_upper_kg", f"lies below safety.mass_lower_kg = {safety.mass_lower_kg:g}")
        _check_brake(safety, config)


def _check_brake(safety: EnergyGuardConfig, config: Config) -> None:
    """What is left of the thrust when weight and current have taken their share must suffice for braking."""
    vehicle = config.vehicle
    thrust = min(vehicle.tau_max[:2])
    if len(config.scenario.start) > 1:
        thrust = min(thrust, vehicle.tau_max[2] - abs(vehicle.weight_N - vehicle.buoyancy_N))
    thrust -= current_drag_N(config.scenario, vehicle)
    if safety.brake_force_N > thrust:
        raise ConfigError(
            "safety.brake_force_N",
            f"exceeds the {thrust:.3g} N of vehicle.tau_max that weight and current leave for braking",
        )


def check_guidance(guidance: GuidanceConfig, scenario: ScenarioConfig) -> None:
    here = ["geodesic", "unit_cost"] if isinstance(guidance, GeodesicConfig) else ["straight"]
    named(guidance.name, "guidance.name", ("straight", "geodesic", "unit_cost"), here)
    if isinstance(guidance, GeodesicConfig):
        for name in ("gain", "lateral_damping", "heading_stiffness", "heading_damping", "spacing_m"):
            positive(getattr(guidance, name), f"guidance.{name}")
        for name in ("exponent", "hard_clearance_m"):
            positive(getattr(guidance, name), f"guidance.{name}", zero=True)
        places = [scenario.source_m, scenario.destination_m, *scenario.start, *(o.center_m for o in scenario.obstacles)]
        sides = [max(p[axis] for p in places) - min(p[axis] for p in places) for axis in (0, 1)]
        nodes = math.prod(side / guidance.spacing_m for side in sides) * len(scenario.start)
        if nodes > MAX_NODES:
            raise ConfigError(
                "guidance.spacing_m",
                f"makes maps of {nodes:,.0f} nodes, of which memory holds {MAX_NODES:,}; choose a larger one",
            )


def check_solver(solver: SolverConfig) -> None:
    rls = ("rls_paper", "rls_forgetting")
    least_squares = ("z_rls", *BATCH)
    here = rls if isinstance(solver, RlsSolverConfig) else least_squares
    named(solver.name, "solver.name", (*least_squares, *rls), here)
    if isinstance(solver, LeastSquaresSolverConfig):
        if solver.name in BATCH and solver.bounded != BATCH[solver.name]:
            raise ConfigError(
                "solver.bounded", "says otherwise than the solver's name; choose solver=batch or bounded_batch"
            )
        positive(solver.ridge, "solver.ridge", zero=True)
        positive(solver.prior, "solver.prior", zero=True)
    if isinstance(solver, RlsSolverConfig):
        positive(solver.kappa, "solver.kappa")
        positive(solver.p0, "solver.p0")
        if solver.name == "rls_forgetting" and solver.kappa > 1.0:
            raise ConfigError("solver.kappa", f"a forgetting factor lies in (0, 1], got {solver.kappa:g}")


def check_experience(experience: ExperienceConfig, planner: IrlConfig, dt: float) -> None:
    here = "parallel" if isinstance(experience, ParallelConfig) else "virtual_links"
    named(experience.name, "experience.name", ("virtual_links", "parallel"), [here])
    steps(experience.leg_s, dt, "experience.leg_s")
    if experience.leg_s < planner.window_s:
        raise ConfigError("experience.leg_s", f"{experience.leg_s:g} s is shorter than planner.window_s")
    each(experience.excitation_rms, "experience.excitation_rms", 4)
    for name in ("excitation_strength", "excitation_band_rad_s"):
        low_high = getattr(experience, name)
        finite(low_high, f"experience.{name}", 2)
        if not 0.0 <= low_high[0] <= low_high[1]:
            raise ConfigError(f"experience.{name}", f"must be [low, high] with 0 <= low <= high, got {low_high}")
    for name in ("across_share", "up_m", "yaw_rad", "near_scale"):
        positive(getattr(experience, name), f"experience.{name}")
    if not 0.0 <= experience.near_share <= 1.0:
        raise ConfigError("experience.near_share", f"is a share between 0 and 1, got {experience.near_share:g}")
    if isinstance(experience, VirtualLinksConfig):
        if experience.relabel < 0:
            raise ConfigError("experience.relabel", f"must be at least 0, got {experience.relabel}")
        positive(experience.relabel_time_s, "experience.relabel_time_s")
    if isinstance(experience, ParallelConfig) and experience.worlds < 1:
        raise ConfigError("experience.worlds", f"must be at least 1, got {experience.worlds}")


def check_planner(planner: PlannerConfig, group: str, config: Config) -> None:
    dt = config.scenario.dt_s
    if isinstance(planner, OwnPlannerConfig):
        return
    kinds = {IrlConfig: "irl", PdConfig: "pd", PotentialFieldConfig: "potential_field"}
    kinds |= {TrajectoryOptimizationConfig: "trajectory_optimization"}
    named(planner.name, f"{group}.name", kinds.values(), [kinds[type(planner)]])
    if isinstance(planner, (IrlConfig, PdConfig)):
        steps(planner.calibration_s, dt, f"{group}.calibration_s", least=4)
    if isinstance(planner, PdConfig):
        each(planner.position_gain, f"{group}.position_gain", 4)
        each(planner.velocity_gain, f"{group}.velocity_gain", 4)
        positive(planner.saturation_m, f"{group}.saturation_m")
    if isinstance(planner, TrajectoryOptimizationConfig):
        if planner.intervals < 10:
            raise ConfigError(f"{group}.intervals", f"must be at least 10, got {planner.intervals}")
        for speed in planner.speeds_mps:
            positive(speed, f"{group}.speeds_mps")
        if not planner.speeds_mps:
            raise ConfigError(f"{group}.speeds_mps", "needs at least one speed")
        for own in ("vehicle", "channel"):
            if getattr(config, own).target is not None:
                problem = f"plans with the equations of uwirl's own {own}, not of {own}.target"
                raise ConfigError(f"{group}.name", problem)
    if isinstance(planner, PotentialFieldConfig):
        positive(planner.repulsion, f"{group}.repulsion")
        positive(planner.reach_m, f"{group}.reach_m")
    if isinstance(planner, IrlConfig):
        window = steps(planner.window_s, dt, f"{group}.window_s", least=2)
        if window % 2:
            raise ConfigError(
                f"{group}.window_s", f"must be an even number of steps for Simpson's rule, got {window} x {dt:g} s"
            )
        steps(planner.stride_s, dt, f"{group}.stride_s")
        positive(planner.residual_floor, f"{group}.residual_floor")
        if planner.updates < 1:
            raise ConfigError(f"{group}.updates", f"must be at least 1, got {planner.updates}")
        one_of(planner.actor_sign, f"{group}.actor_sign", ("corrected", "printed"))
        each(planner.inertia_lower, f"{group}.inertia_lower", 4)
        # Below, the weakest damping that the bounds ask for would already ring under a control held for dt.
        for axis, inertia, least in zip(AXES, planner.inertia_lower, (4.0, 4.0, 4.0, 3.0), strict=True):
            if inertia < least * dt:
                raise ConfigError(
                    f"{group}.inertia_lower", f"{axis} must be at least {least * dt:.3g}, got {inertia:g}"
                )
        positive(planner.tolerance_weights, f"{group}.tolerance_weights", zero=True)
        positive(planner.tolerance_inverse_capacity, f"{group}.tolerance_inverse_capacity", zero=True)
        check_experience(config.experience, planner, dt)
        positive(planner.max_time_s, f"{group}.max_time_s")
        if not math.isfinite(planner.start_gain):
            raise ConfigError(f"{group}.start_gain", f"must be finite, got {planner.start_gain}")
        if planner.max_time_s < planner.calibration_s + config.experience.leg_s:
            raise ConfigError(
                f"{group}.max_time_s", f"{planner.max_time_s:g} s is shorter than the calibration hover and one leg"
            )
