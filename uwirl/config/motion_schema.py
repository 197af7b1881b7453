"""Names, types, units and rules of what motion is planned and learned with, from the basis to the planner."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from omegaconf import MISSING

from uwirl.config.checks import (
    MadeConfig,
    at_least,
    finite,
    low_high,
    not_negative,
    numbers,
    positive,
    ruled,
    share,
)

# Names of uwirl's own options.
BasisName = StrEnum("BasisName", ["link_frame", "geodesic", "error_quadratic", "error_velocity"])
SafetyName = StrEnum("SafetyName", ["energy", "barrier", "none"])
GuidanceName = StrEnum("GuidanceName", ["straight", "geodesic", "unit_cost"])
SolverName = StrEnum("SolverName", ["z_rls", "batch", "bounded_batch", "rls_paper", "rls_forgetting"])
ExperienceName = StrEnum("ExperienceName", ["virtual_links", "parallel", "mission"])
PlannerName = StrEnum("PlannerName", ["irl", "identified", "pd", "potential_field", "trajectory_optimization"])

Avoidance = StrEnum("Avoidance", ["smooth", "printed"])
ActorSign = StrEnum("ActorSign", ["corrected", "printed"])
RlsForm = StrEnum("RlsForm", ["paper", "exponential"])


@dataclass
class BasisConfig(MadeConfig, family="basis"):
    name: str = MISSING  # link_frame | geodesic | error_quadratic | error_velocity; any with a class of your own


@dataclass
class LinkFrameBasisConfig(BasisConfig, names=(BasisName.link_frame,), file="link_frame_schema"):
    length_scales_m: list[float] = MISSING  # m; .inf gives the linear feature

    def problems(self) -> Iterator[tuple[str, str]]:
        scales = self.length_scales_m
        if not scales or any(not L > 0.0 for L in scales) or len(set(scales)) < len(scales):
            yield "length_scales_m", f"needs one or more different positive lengths, got {scales}"


@dataclass
class GeodesicBasisConfig(LinkFrameBasisConfig, names=(BasisName.geodesic,), file="geodesic_schema"):
    pass


@dataclass
class ErrorBasisConfig(BasisConfig, names=(BasisName.error_quadratic, BasisName.error_velocity), file="error_schema"):
    velocity: bool = MISSING  # whether the features see the velocity, too

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.velocity != (self.name == BasisName.error_velocity):
            yield "velocity", "says otherwise than the name; choose basis=error_quadratic or error_velocity"


@dataclass
class CostConfig(MadeConfig, family="cost"):
    beta_1: float = ruled(positive)  # (kbit/s)^2; weight of the link cost 1/C^2
    beta_2: float = ruled(not_negative)  # m^2; weight of the avoidance term
    avoidance: Avoidance = MISSING  # form of the avoidance term, which goes with the option
    yaw_weight: float = ruled(not_negative)  # of 1 - cos of the yaw error; without it the optimal yaw weights are zero
    R: list[float] = ruled(numbers(4))  # control weights of (tau / tau_max)^2 in surge, sway, heave, yaw

    def problems(self) -> Iterator[tuple[str, str]]:
        if (self.avoidance == Avoidance.printed) != isinstance(self, PrintedCostConfig):
            yield "avoidance", f"{self.avoidance!r} needs other settings than these; choose cost=relay or cost=paper"
        if min(self.R) <= 0.0:
            yield "R", f"must be positive definite, that is all four greater than 0, got {self.R}"


@dataclass
class PrintedCostConfig(CostConfig, file="printed_schema"):
    left_m: float = MISSING  # m; Remark 2: where f is kappa_1, just within the radius of influence
    right_m: float = MISSING  # m; Remark 2: where f has fallen to kappa_2
    kappa_1: float = MISSING  # in (kappa_2, 1)
    kappa_2: float = MISSING  # in (0, kappa_1)

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0.0 < self.left_m < self.right_m:
            yield "left_m", f"must lie between 0 and right_m = {self.right_m:g}, got {self.left_m:g}"
        if not 0.0 < self.kappa_2 < self.kappa_1 < 1.0:
            yield "kappa_1", "needs 0 < kappa_2 < kappa_1 < 1 (Remark 2)"
        yield from super().problems()


@dataclass
class SafetyConfig(MadeConfig, family="safety", names=(SafetyName.none,)):
    name: str = MISSING  # energy | barrier | none


@dataclass
class GuardConfig(SafetyConfig):
    margin_m: float = ruled(not_negative)  # m; kept from obstacles beside the vehicle's radius
    separation_m: float = ruled(positive)  # m; kept between the centres of vehicles


@dataclass
class BarrierGuardConfig(GuardConfig, names=(SafetyName.barrier,), file="barrier_schema"):
    k_1: float = ruled(positive)  # 1/s; of the second-order barrier h'' + k_1 h' + k_0 h >= 0
    k_0: float = ruled(positive)  # 1/s^2; of the same
    inertia_kg: list[float] = ruled(numbers(3, positive))  # kg; mass and added mass in surge, sway, heave

    def problems(self) -> Iterator[tuple[str, str]]:
        # Else h swings through zero.
        if self.k_1**2 < 4.0 * self.k_0:
            yield "k_0", f"must be at most safety.k_1^2 / 4 = {self.k_1**2 / 4.0:g}, or the barrier is crossed"


@dataclass
class EnergyGuardConfig(GuardConfig, names=(SafetyName.energy,), file="energy_schema"):
    alpha: float = ruled(positive)  # 1/s; how fast the barrier may fall
    mass_upper_kg: float = ruled(positive)  # kg; no less than the vehicle has, added mass included
    mass_lower_kg: float = ruled(positive)  # kg; no more than the vehicle has, added mass included
    brake_force_N: float = ruled(positive)  # N; that thrusters can always brake with

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.mass_upper_kg < self.mass_lower_kg:
            yield "mass_upper_kg", f"lies below safety.mass_lower_kg = {self.mass_lower_kg:g}"


@dataclass
class GuidanceConfig(MadeConfig, family="guidance", names=(GuidanceName.straight,)):
    name: str = MISSING  # straight | geodesic | unit_cost


@dataclass
class GeodesicConfig(GuidanceConfig, names=(GuidanceName.geodesic, GuidanceName.unit_cost), file="geodesic_schema"):
    gain: float = ruled(positive)  # k of F = k sqrt(q / R_b)
    lateral_damping: float = ruled(positive)  # N s/m; against velocity across the way
    heading_stiffness: float = ruled(positive)  # N m, added to the led policy's while routing
    heading_damping: float = ruled(positive)  # N m s/rad
    spacing_m: float = ruled(positive)  # m; of the map's nodes
    exponent: float = ruled(not_negative)  # of the slowness in q; 0 gives the shortest way
    hard_clearance_m: float = ruled(not_negative)  # m; closer than this counts as inside an obstacle


@dataclass
class SolverConfig(MadeConfig, family="solver"):
    name: str = MISSING  # z_rls | batch | bounded_batch | rls_paper | rls_forgetting


@dataclass
class LeastSquaresSolverConfig(SolverConfig, names=(SolverName.z_rls,), file="least_squares_schema"):
    bounded: bool = MISSING  # whether the actor stays a damped convex potential
    ridge: float = ruled(not_negative)  # penalty on every unknown, towards zero
    prior: float = ruled(not_negative)  # penalty on the actor, towards the policy that it improves


@dataclass
class BatchSolverConfig(
    LeastSquaresSolverConfig, names=(SolverName.batch, SolverName.bounded_batch), file="batch_schema"
):
    def problems(self) -> Iterator[tuple[str, str]]:
        if self.bounded != (self.name == SolverName.bounded_batch):
            yield "bounded", "says otherwise than the solver's name; choose solver=batch or bounded_batch"


@dataclass
class RlsSolverConfig(SolverConfig, names=(SolverName.rls_paper, SolverName.rls_forgetting), file="rls_schema"):
    kappa: float = ruled(positive)  # of (48)-(49): forgetting factor in (0, 1] of rls_forgetting, a ridge in rls_paper
    p0: float = ruled(positive)  # of the first covariance, P = p0 I
    form: RlsForm = MISSING  # as printed, or with exponential forgetting

    def problems(self) -> Iterator[tuple[str, str]]:
        if (self.form == RlsForm.exponential) != (self.name == SolverName.rls_forgetting):
            yield "form", "says otherwise than the solver's name; choose solver=rls_paper or rls_forgetting"
        if self.name == SolverName.rls_forgetting and self.kappa > 1.0:
            yield "kappa", f"a forgetting factor lies in (0, 1], got {self.kappa:g}"


@dataclass
class ExperienceConfig(MadeConfig, family="experience"):
    name: str = MISSING  # virtual_links | parallel
    leg_s: float = MISSING  # s; flown towards one virtual link
    max_time_s: float = MISSING  # s; what planner.max_time_s is unless it is set
    model_time_s: float = MISSING  # s; what planner.model_time_s is unless it is set
    model_window_s: float = MISSING  # s; what planner.model_window_s is unless it is set
    excitation_rms: list[float] = ruled(numbers(4, positive))  # N, N, N, N m; of the probing thrust
    excitation_strength: list[float] = ruled(low_high)  # [low, high] of the factor on it that each leg draws
    excitation_band_rad_s: list[float] = ruled(low_high)  # rad/s; [low, high] of its sines
    across_share: float = ruled(positive)  # width of starts across the link, as a share of that along it
    up_m: float = ruled(positive)  # m; half width of starts in the vertical
    yaw_rad: float = ruled(positive)  # rad; half width of starts in yaw
    near_share: float = ruled(share)  # in [0, 1]; share of legs that start close to the target
    near_scale: float = ruled(positive)  # by which their widths along and across the link shrink


@dataclass
class VirtualLinksConfig(ExperienceConfig, names=(ExperienceName.virtual_links,), file="virtual_links_schema"):
    relabel: int = ruled(at_least(0))  # further virtual links that each leg is seen from; 0 for none
    relabel_time_s: float = ruled(positive)  # s; after which what was seen so counts 1/e of what was flown


@dataclass
class MissionsConfig(VirtualLinksConfig, names=(ExperienceName.mission,), file="mission_schema"):
    pass


@dataclass
class ParallelConfig(ExperienceConfig, names=(ExperienceName.parallel,), file="parallel_schema"):
    worlds: int = ruled(at_least(1))  # how many fly at once


@dataclass
class PlannerConfig(MadeConfig, family="planner"):
    # irl | identified | pd | potential_field | trajectory_optimization; any with a class of your own
    name: str = MISSING


@dataclass
class IrlConfig(PlannerConfig, names=(PlannerName.irl,), file="irl_schema"):
    calibration_s: float = MISSING  # s; of hovering, in which trim is measured
    start_gain: float = ruled(finite)  # scales the start policy
    # kg, kg, kg, kg m^2; no more than the vehicle has, added mass included
    inertia_lower: list[float] = ruled(numbers(4, positive))
    window_s: float = MISSING  # s; of one Bellman equation, an even number of steps
    stride_s: float = MISSING  # s; between the beginnings of windows
    residual_floor: float = ruled(positive)  # share of the cost of the link without a relay
    updates: int = ruled(at_least(1))  # policy iterations after each leg
    actor_sign: ActorSign = MISSING  # that of the derivation, or of the paper
    # epsilon_3; relative change of the weights below which they have settled
    tolerance_weights: float = ruled(not_negative)
    tolerance_inverse_capacity: float = ruled(not_negative)  # epsilon_4, s/kbit
    max_time_s: float = ruled(positive)  # s; T_max,2, vehicle time
    model_time_s: float = ruled(
        positive
    )  # s; vehicle time after which the model for flights along routes is identified
    model_window_s: float = MISSING  # s; of the integrals of one row of it
    most_doubt: float = ruled(positive)  # largest standard error of an inertia, as a share of it


@dataclass
class IdentifiedConfig(PlannerConfig, names=(PlannerName.identified,), file="identified_schema"):
    calibration_s: float = MISSING  # s; of hovering, in which trim is measured
    max_time_s: float = ruled(positive)  # s; of the flight that identifies the model, the hover included
    window_s: float = MISSING  # s; of the integrals of one row
    most_doubt: float = ruled(positive)  # largest standard error of an inertia, as a share of it
    # kg, kg, kg, kg m^2; no more than the vehicle has, added mass included
    inertia_lower: list[float] = ruled(numbers(4, positive))
    node_s: float = ruled(positive)  # s; between the nodes of a plan
    replan_s: float = MISSING  # s; between plans
    refine: int = ruled(at_least(0))  # iterations of a plan that begins with the one before


@dataclass
class PdConfig(PlannerConfig, names=(PlannerName.pd,), file="pd_schema"):
    calibration_s: float = MISSING  # s; of hovering, in which trim is measured
    position_gain: list[float] = ruled(numbers(4, positive))  # N/m, yaw N m; surge, sway, heave, yaw
    velocity_gain: list[float] = ruled(numbers(4, positive))  # N s/m, yaw N m s/rad; surge, sway, heave, yaw
    saturation_m: float = ruled(positive)  # m; errors beyond pull no harder


@dataclass
class PotentialFieldConfig(PdConfig, names=(PlannerName.potential_field,), file="potential_field_schema"):
    repulsion: float = ruled(positive)  # N m^3; strength of the repulsion
    reach_m: float = ruled(positive)  # m; clearance at which it begins


@dataclass
class TrajectoryOptimizationConfig(
    PlannerConfig, names=(PlannerName.trajectory_optimization,), file="trajectory_optimization_schema"
):
    intervals: int = ruled(at_least(10))  # of the collocation, over the mission
    speeds_mps: list[float] = MISSING  # m/s; of the guesses along the map

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.speeds_mps:
            yield "speeds_mps", "needs at least one speed"
        for speed in self.speeds_mps:
            problem = positive(speed)
            if problem:
                yield "speeds_mps", problem
