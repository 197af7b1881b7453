"""Names, types and units of every setting. Values stand in conf/, rules in `uwirl.config.validate`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from uwirl.config.channel_schema import ChannelConfig


@dataclass
class ObstacleConfig:
    center_m: list[float] = MISSING  # [x, y] of a vertical cylinder's axis
    radius_m: float = MISSING
    influence_m: float = MISSING  # where the avoidance term of the cost begins
    velocity_mps: list[float] = field(default_factory=lambda: [0.0, 0.0])


@dataclass
class LayoutsConfig:
    """Random layouts that what was learned is judged in, instead of the scenario's own start and obstacles."""

    count: int = MISSING
    seed: int = MISSING
    kinds: list[str] = MISSING  # taken in turn: sparse | random | overlapping | dead_end | ring | moving
    half_width_m: float = 30.0  # of the square around the targets in which vehicles start
    current_mps: float = 0.0  # of a constant current from another side in each world


@dataclass
class ScenarioConfig:
    source_m: list[float] = MISSING  # [x, y, z], z up
    destination_m: list[float] = MISSING
    # eta of each vehicle, m and rad; not list[list[float]], which would refuse [0, 0, -5, 1]
    start: list[Any] = MISSING
    sensors: Any = MISSING  # a number, spread by the seed, or a list of [x, y, z] in m
    obstacles: list[ObstacleConfig] = field(default_factory=list)
    layouts: LayoutsConfig | None = None
    hearing_range_m: float = MISSING  # of acoustic messages
    message_period_s: float = MISSING
    detection_range_m: float = MISSING  # from hull to hull; .inf where the map is known
    current_mps: list[float] = MISSING  # mean of the ocean current, inertial [x, y, z]
    current_std_mps: float = MISSING  # of its Gauss-Markov part, each horizontal component
    current_time_s: float = MISSING  # correlation time of that part
    depth_m: float = MISSING  # of the water: vehicles stay in -depth_m <= z <= 0
    vehicle_radius_m: float = MISSING
    dt_s: float = MISSING
    duration_s: float = MISSING


@dataclass
class VehicleConfig:
    mass_kg: float = MISSING
    yaw_inertia: float = MISSING  # kg m^2
    added_mass: list[float] = MISSING  # surge, sway, heave in kg, yaw in kg m^2
    linear_damping: list[float] = MISSING  # N s/m, yaw N m s/rad
    quadratic_damping: list[float] = MISSING  # N s^2/m^2, yaw N m s^2/rad^2
    weight_N: float = MISSING
    buoyancy_N: float = MISSING
    tau_max: list[float] = MISSING  # N, N, N, N m


@dataclass
class EstimatorConfig:
    # least_squares | generalized_least_squares | separate | maximum_likelihood | disk | oracle
    name: str = MISSING
    robust: bool = False  # leave out readings and sensors that stand apart from the others


@dataclass
class BasisConfig:
    name: str = MISSING  # link_frame | geodesic | error_quadratic | error_velocity
    length_scales_m: list[float] = field(default_factory=list)  # link_frame and geodesic; .inf gives the linear feature


@dataclass
class CostConfig:
    beta_1: float = MISSING  # (kbit/s)^2
    beta_2: float = MISSING  # m^2
    avoidance: str = MISSING  # smooth | printed
    yaw_weight: float = MISSING
    R: list[float] = MISSING  # of tau / tau_max


@dataclass
class PrintedCostConfig(CostConfig):
    # Remark 2: f falls from kappa_1 at left_m, just within the radius of influence, to kappa_2 at right_m.
    left_m: float = MISSING
    right_m: float = MISSING
    kappa_1: float = MISSING
    kappa_2: float = MISSING


@dataclass
class SafetyConfig:
    name: str = MISSING  # energy | barrier | none


@dataclass
class GuardConfig(SafetyConfig):
    margin_m: float = MISSING
    separation_m: float = MISSING  # between the centres of vehicles


@dataclass
class BarrierGuardConfig(GuardConfig):
    k_1: float = MISSING  # 1/s
    k_0: float = MISSING  # 1/s^2
    inertia_kg: list[float] = MISSING  # surge, sway, heave


@dataclass
class EnergyGuardConfig(GuardConfig):
    alpha: float = MISSING  # 1/s
    mass_upper_kg: float = MISSING
    mass_lower_kg: float = MISSING
    brake_force_N: float = MISSING


@dataclass
class SolverConfig:
    name: str = MISSING  # z_rls | batch | bounded_batch | rls_paper | rls_forgetting


@dataclass
class LeastSquaresSolverConfig(SolverConfig):
    bounded: bool = MISSING
    ridge: float = MISSING
    prior: float = MISSING


@dataclass
class RlsSolverConfig(SolverConfig):
    kappa: float = MISSING
    p0: float = MISSING


@dataclass
class ExperienceConfig:
    name: str = MISSING  # virtual_links | parallel
    leg_s: float = MISSING
    max_time_s: float = MISSING  # what planner.max_time_s is unless it is set
    excitation_rms: list[float] = MISSING  # N, N, N, N m
    excitation_strength: list[float] = MISSING  # range of a leg's strength
    excitation_band_rad_s: list[float] = MISSING
    across_share: float = MISSING  # width across the link, as a share of that along it
    up_m: float = MISSING
    yaw_rad: float = MISSING
    near_share: float = MISSING
    near_scale: float = MISSING


@dataclass
class VirtualLinksConfig(ExperienceConfig):
    relabel: int = MISSING
    relabel_time_s: float = MISSING


@dataclass
class ParallelConfig(ExperienceConfig):
    worlds: int = MISSING


@dataclass
class PlannerConfig:
    name: str = MISSING  # irl | pd | potential_field | trajectory_optimization
    calibration_s: float = MISSING


@dataclass
class IrlConfig(PlannerConfig):
    start_gain: float = MISSING
    inertia_lower: list[float] = MISSING  # kg, kg, kg, kg m^2
    window_s: float = MISSING
    stride_s: float = MISSING
    residual_floor: float = MISSING  # share of the cost of the link without a relay
    updates: int = MISSING
    actor_sign: str = MISSING  # corrected | printed
    tolerance_weights: float = MISSING  # epsilon_3
    tolerance_inverse_capacity: float = MISSING  # epsilon_4, s/kbit
    max_time_s: float = MISSING  # T_max,2, vehicle time


@dataclass
class PdConfig(PlannerConfig):
    position_gain: list[float] = MISSING  # N/m, yaw N m
    velocity_gain: list[float] = MISSING  # N s/m, yaw N m s/rad
    saturation_m: float = MISSING


@dataclass
class PotentialFieldConfig(PdConfig):
    repulsion: float = MISSING  # N m^3
    reach_m: float = MISSING  # clearance at which it begins


@dataclass
class TrajectoryOptimizationConfig(PlannerConfig):
    intervals: int = MISSING
    speeds_mps: list[float] = MISSING  # of the guesses along the map


@dataclass
class GuidanceConfig:
    name: str = MISSING  # straight | geodesic


@dataclass
class GeodesicConfig(GuidanceConfig):
    gain: float = MISSING  # k of F = k sqrt(q / R_b)
    lateral_damping: float = MISSING  # N s/m
    heading_stiffness: float = MISSING  # N m, added to the led policy's while routing
    heading_damping: float = MISSING  # N m s/rad
    spacing_m: float = MISSING  # of the map
    exponent: float = MISSING  # of the slowness in q; 0 gives the shortest way
    hard_clearance_m: float = MISSING  # closer than this counts as inside an obstacle


@dataclass
class LoggingConfig:
    tensorboard: bool = MISSING
    figures: bool = MISSING
    animation: bool = MISSING
    progress: bool = MISSING


@dataclass
class CheckpointConfig:
    every: int = MISSING  # legs of the learning flight between two saves


@dataclass
class Config:
    scenario: ScenarioConfig = MISSING
    channel: ChannelConfig = MISSING
    vehicle: VehicleConfig = MISSING
    estimator: EstimatorConfig = MISSING
    basis: BasisConfig = MISSING
    cost: CostConfig = MISSING
    guidance: GuidanceConfig = MISSING
    safety: SafetyConfig = MISSING
    solver: SolverConfig = MISSING
    experience: ExperienceConfig = MISSING
    planner: PlannerConfig = MISSING
    baseline: PlannerConfig = MISSING  # flown beside a learned policy
    logging: LoggingConfig = MISSING
    checkpoint: CheckpointConfig = field(default_factory=lambda: CheckpointConfig())
    resume: str | None = MISSING  # a checkpoint or run folder, whose run is continued
    init_from: str | None = MISSING  # a checkpoint or run folder, whose results a new run starts from
    init_from_parts: list[str] = MISSING  # estimate | weights
    seed: int = MISSING
    threads: int = MISSING
    device: str = MISSING
    dtype: str = MISSING  # float64 | float32, of the environment; learning is float64 always


def register() -> None:
    """Make the schemas known to Hydra; YAML files name them in their defaults lists."""
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    groups: dict[str, dict[str, type]] = {
        "scenario": {"schema": ScenarioConfig},
        "channel": {"schema": ChannelConfig},
        "vehicle": {"schema": VehicleConfig},
        "estimator": {"schema": EstimatorConfig},
        "basis": {"schema": BasisConfig},
        "cost": {"schema": CostConfig, "printed_schema": PrintedCostConfig},
        "guidance": {"schema": GuidanceConfig, "geodesic_schema": GeodesicConfig},
        "safety": {"schema": SafetyConfig, "energy_schema": EnergyGuardConfig, "barrier_schema": BarrierGuardConfig},
        "solver": {"least_squares_schema": LeastSquaresSolverConfig, "rls_schema": RlsSolverConfig},
        "experience": {"virtual_links_schema": VirtualLinksConfig, "parallel_schema": ParallelConfig},
        "planner": {
            "irl_schema": IrlConfig,
            "pd_schema": PdConfig,
            "potential_field_schema": PotentialFieldConfig,
            "trajectory_optimization_schema": TrajectoryOptimizationConfig,
        },
        "logging": {"schema": LoggingConfig},
    }
    for group, schemas in groups.items():
        for name, node in schemas.items():
            store.store(group=group, name=name, node=node)
