"""Names, types and units of the settings of planners, and of what the learning one is made of."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import MISSING

from uwirl.config.own_schema import OwnConfig


@dataclass
class SolverConfig:
    name: str = MISSING  # z_rls | batch | bounded_batch | rls_paper | rls_forgetting


@dataclass
class LeastSquaresSolverConfig(SolverConfig):
    bounded: bool = MISSING  # whether the actor stays a damped convex potential
    ridge: float = MISSING  # penalty on every unknown, towards zero
    prior: float = MISSING  # penalty on the actor, towards the policy that it improves


@dataclass
class RlsSolverConfig(SolverConfig):
    kappa: float = MISSING  # of (48)-(49): forgetting factor in (0, 1] of rls_forgetting, a ridge in rls_paper
    p0: float = MISSING  # of the first covariance, P = p0 I


@dataclass
class ExperienceConfig:
    name: str = MISSING  # virtual_links | parallel
    leg_s: float = MISSING  # s; flown towards one virtual link
    max_time_s: float = MISSING  # s; what planner.max_time_s is unless it is set
    excitation_rms: list[float] = MISSING  # N, N, N, N m; of the probing thrust
    excitation_strength: list[float] = MISSING  # [low, high] of the factor on it that each leg draws
    excitation_band_rad_s: list[float] = MISSING  # rad/s; [low, high] of its sines
    across_share: float = MISSING  # width of starts across the link, as a share of that along it
    up_m: float = MISSING  # m; half width of starts in the vertical
    yaw_rad: float = MISSING  # rad; half width of starts in yaw
    near_share: float = MISSING  # in [0, 1]; share of legs that start close to the target
    near_scale: float = MISSING  # by which their widths along and across the link shrink


@dataclass
class VirtualLinksConfig(ExperienceConfig):
    relabel: int = MISSING  # further virtual links that each leg is seen from; 0 for none
    relabel_time_s: float = MISSING  # s; after which what was seen so counts 1/e of what was flown


@dataclass
class ParallelConfig(ExperienceConfig):
    worlds: int = MISSING  # how many fly at once


@dataclass
class PlannerConfig:
    name: str = MISSING  # irl | pd | potential_field | trajectory_optimization; any with a target


@dataclass
class OwnPlannerConfig(OwnConfig, PlannerConfig):
    pass


@dataclass
class IrlConfig(PlannerConfig):
    calibration_s: float = MISSING  # s; of hovering, in which trim is measured
    start_gain: float = MISSING  # scales the start policy
    inertia_lower: list[float] = MISSING  # kg, kg, kg, kg m^2; no more than the vehicle has, added mass included
    window_s: float = MISSING  # s; of one Bellman equation, an even number of steps
    stride_s: float = MISSING  # s; between the beginnings of windows
    residual_floor: float = MISSING  # share of the cost of the link without a relay
    updates: int = MISSING  # policy iterations after each leg
    actor_sign: str = MISSING  # corrected | printed
    tolerance_weights: float = MISSING  # epsilon_3; relative change of the weights below which they have settled
    tolerance_inverse_capacity: float = MISSING  # epsilon_4, s/kbit
    max_time_s: float = MISSING  # s; T_max,2, vehicle time


@dataclass
class PdConfig(PlannerConfig):
    calibration_s: float = MISSING  # s; of hovering, in which trim is measured
    position_gain: list[float] = MISSING  # N/m, yaw N m; surge, sway, heave, yaw
    velocity_gain: list[float] = MISSING  # N s/m, yaw N m s/rad; surge, sway, heave, yaw
    saturation_m: float = MISSING  # m; errors beyond pull no harder


@dataclass
class PotentialFieldConfig(PdConfig):
    repulsion: float = MISSING  # N m^3; strength of the repulsion
    reach_m: float = MISSING  # m; clearance at which it begins


@dataclass
class TrajectoryOptimizationConfig(PlannerConfig):
    intervals: int = MISSING  # of the collocation, over the mission
    speeds_mps: list[float] = MISSING  # m/s; of the guesses along the map
