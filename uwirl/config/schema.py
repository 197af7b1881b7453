"""Names, types and units of every setting. Values stand in conf/, rules in `uwirl.config.validate`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from uwirl.config.channel_schema import ChannelConfig
from uwirl.config.own_schema import OwnConfig
from uwirl.config.planner_schema import (
    ExperienceConfig,
    IrlConfig,
    LeastSquaresSolverConfig,
    OwnPlannerConfig,
    ParallelConfig,
    PdConfig,
    PlannerConfig,
    PotentialFieldConfig,
    RlsSolverConfig,
    SolverConfig,
    TrajectoryOptimizationConfig,
    VirtualLinksConfig,
)
from uwirl.config.search_schema import SearchConfig


@dataclass
class ObstacleConfig:
    center_m: list[float] = MISSING  # m; [x, y] of a vertical cylinder's axis
    radius_m: float = MISSING  # m; of the cylinder
    influence_m: float = MISSING  # m; from the axis, where the avoidance term of the cost begins
    velocity_mps: list[float] = field(default_factory=lambda: [0.0, 0.0])  # m/s; [x, y] of a drifting cylinder


@dataclass
class LayoutsConfig:
    """Random layouts that what was learned is judged in, instead of the scenario's own start and obstacles."""

    count: int = MISSING  # how many worlds
    seed: int = MISSING  # of the layouts, apart from that of the run
    kinds: list[str] = MISSING  # taken in turn: sparse | random | overlapping | dead_end | ring | moving
    half_width_m: float = 30.0  # m; of the square around the targets in which vehicles start
    current_mps: float = 0.0  # m/s; of a constant current from another side in each world


@dataclass
class ScenarioConfig:
    source_m: list[float] = MISSING  # m; [x, y, z] of the node that sends, z up, 0 at the surface
    destination_m: list[float] = MISSING  # m; [x, y, z] of the node that receives
    # Not list[list[float]], which would refuse [0, 0, -5, 1].
    start: list[Any] = MISSING  # eta of each vehicle, [x, y, z, psi] in m and rad
    sensors: Any = MISSING  # a number, spread by the seed, or a list of [x, y, z] in m
    obstacles: list[ObstacleConfig] = field(default_factory=list)  # standing or drifting cylinders
    layouts: LayoutsConfig | None = None  # random worlds to be judged in, or null for this one alone
    hearing_range_m: float = MISSING  # m; of acoustic messages, .inf for all
    message_period_s: float = MISSING  # s; between messages, each of which every sensor in range reads
    detection_range_m: float = MISSING  # m; from hull to hull; .inf where the map is known
    current_mps: list[float] = MISSING  # m/s; mean of the ocean current, inertial [x, y, z]
    current_std_mps: float = MISSING  # m/s; of its Gauss-Markov part, each horizontal component
    current_time_s: float = MISSING  # s; correlation time of that part
    depth_m: float = MISSING  # m; of the water: vehicles stay in -depth_m <= z <= 0
    vehicle_radius_m: float = MISSING  # m; of the sphere around a vehicle that touches nothing
    dt_s: float = MISSING  # s; step of control and of integration (RK4)
    duration_s: float = MISSING  # s; of the mission that is evaluated


@dataclass
class VehicleParameters:
    mass_kg: float = MISSING  # kg
    yaw_inertia: float = MISSING  # kg m^2; about the vertical axis
    added_mass: list[float] = MISSING  # surge, sway, heave in kg, yaw in kg m^2
    linear_damping: list[float] = MISSING  # N s/m, yaw N m s/rad; surge, sway, heave, yaw
    quadratic_damping: list[float] = MISSING  # N s^2/m^2, yaw N m s^2/rad^2
    weight_N: float = MISSING  # N; in air
    buoyancy_N: float = MISSING  # N; of the displaced water
    tau_max: list[float] = MISSING  # N, N, N, N m; the most that thrusters give in surge, sway, heave, yaw


@dataclass
class VehicleConfig(OwnConfig, VehicleParameters):
    pass


@dataclass
class EstimatorConfig:
    # least_squares | generalized_least_squares | separate | maximum_likelihood | disk | oracle; any with a target
    name: str = MISSING
    robust: bool = False  # leave out readings and sensors that stand apart from the others


@dataclass
class OwnEstimatorConfig(OwnConfig, EstimatorConfig):
    pass


@dataclass
class BasisConfig:
    name: str = MISSING  # link_frame | geodesic | error_quadratic | error_velocity; any with a target


@dataclass
class LinkFrameBasisConfig(BasisConfig):
    length_scales_m: list[float] = MISSING  # m; .inf gives the linear feature


@dataclass
class OwnBasisConfig(OwnConfig, BasisConfig):
    pass


@dataclass
class CostConfig:
    beta_1: float = MISSING  # (kbit/s)^2; weight of the link cost 1/C^2
    beta_2: float = MISSING  # m^2; weight of the avoidance term
    avoidance: str = MISSING  # smooth | printed
    yaw_weight: float = MISSING  # of 1 - cos of the yaw error; without it the optimal yaw weights are zero
    R: list[float] = MISSING  # control weights of (tau / tau_max)^2 in surge, sway, heave, yaw


@dataclass
class PrintedCostConfig(CostConfig):
    left_m: float = MISSING  # m; Remark 2: where f is kappa_1, just within the radius of influence
    right_m: float = MISSING  # m; Remark 2: where f has fallen to kappa_2
    kappa_1: float = MISSING  # in (kappa_2, 1)
    kappa_2: float = MISSING  # in (0, kappa_1)


@dataclass
class SafetyConfig:
    name: str = MISSING  # energy | barrier | none


@dataclass
class GuardConfig(SafetyConfig):
    margin_m: float = MISSING  # m; kept from obstacles beside the vehicle's radius
    separation_m: float = MISSING  # m; kept between the centres of vehicles


@dataclass
class BarrierGuardConfig(GuardConfig):
    k_1: float = MISSING  # 1/s; of the second-order barrier h'' + k_1 h' + k_0 h >= 0
    k_0: float = MISSING  # 1/s^2; of the same
    inertia_kg: list[float] = MISSING  # kg; mass and added mass in surge, sway, heave


@dataclass
class EnergyGuardConfig(GuardConfig):
    alpha: float = MISSING  # 1/s; how fast the barrier may fall
    mass_upper_kg: float = MISSING  # kg; no less than the vehicle has, added mass included
    mass_lower_kg: float = MISSING  # kg; no more than the vehicle has, added mass included
    brake_force_N: float = MISSING  # N; that thrusters can always brake with


@dataclass
class GuidanceConfig:
    name: str = MISSING  # straight | geodesic | unit_cost


@dataclass
class GeodesicConfig(GuidanceConfig):
    gain: float = MISSING  # k of F = k sqrt(q / R_b)
    lateral_damping: float = MISSING  # N s/m; against velocity across the way
    heading_stiffness: float = MISSING  # N m, added to the led policy's while routing
    heading_damping: float = MISSING  # N m s/rad
    spacing_m: float = MISSING  # m; of the map's nodes
    exponent: float = MISSING  # of the slowness in q; 0 gives the shortest way
    hard_clearance_m: float = MISSING  # m; closer than this counts as inside an obstacle


@dataclass
class LoggingConfig:
    tensorboard: bool = MISSING  # write tb/
    figures: bool = MISSING  # write figures/*.png
    animation: bool = MISSING  # write figures/mission.gif
    progress: bool = MISSING  # a line on the terminal while learning


@dataclass
class CheckpointConfig:
    every: int = MISSING  # legs of the learning flight between two saves


@dataclass
class Config:
    scenario: ScenarioConfig = MISSING  # nodes, vehicles, obstacles, water
    channel: ChannelConfig = MISSING  # path loss, noise and fading, the truth of the simulation
    vehicle: VehicleConfig = MISSING  # rigid body, drag, thrusters
    estimator: EstimatorConfig = MISSING  # how readings become a channel
    basis: BasisConfig = MISSING  # features of critic and actor
    cost: CostConfig = MISSING  # what the planner minimises
    guidance: GuidanceConfig = MISSING  # the way among obstacles
    safety: SafetyConfig = MISSING  # the guard between policy and thrusters
    solver: SolverConfig = MISSING  # how Bellman equations become weights
    experience: ExperienceConfig = MISSING  # how the learner flies to learn
    planner: PlannerConfig = MISSING  # what is run
    baseline: PlannerConfig = MISSING  # flown beside a learned policy
    logging: LoggingConfig = MISSING  # what is written besides metrics.json
    checkpoint: CheckpointConfig = field(default_factory=lambda: CheckpointConfig())  # how often a run is saved
    resume: str | None = MISSING  # a checkpoint or run folder, whose run is continued
    init_from: str | None = MISSING  # a checkpoint or run folder, whose results a new run starts from
    init_from_parts: list[str] = MISSING  # estimate | weights
    seed: int = MISSING  # of everything random, in [0, 2^63)
    threads: int = MISSING  # of torch
    device: str = MISSING  # cpu | cuda | cuda:N | mps
    dtype: str = MISSING  # float64 | float32, of the environment; learning is float64 always


def register() -> None:
    """Make the schemas known to Hydra.

    A file of a group names its schema in its defaults list where it has keys that `Config` does not give the group.
    """
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    groups: dict[str, dict[str, type]] = {
        "estimator": {"own_schema": OwnEstimatorConfig},
        "basis": {"link_frame_schema": LinkFrameBasisConfig, "own_schema": OwnBasisConfig},
        "cost": {"printed_schema": PrintedCostConfig},
        "guidance": {"geodesic_schema": GeodesicConfig},
        "safety": {"energy_schema": EnergyGuardConfig, "barrier_schema": BarrierGuardConfig},
        "solver": {"least_squares_schema": LeastSquaresSolverConfig, "rls_schema": RlsSolverConfig},
        "experience": {"virtual_links_schema": VirtualLinksConfig, "parallel_schema": ParallelConfig},
        "planner": {
            "irl_schema": IrlConfig,
            "pd_schema": PdConfig,
            "potential_field_schema": PotentialFieldConfig,
            "trajectory_optimization_schema": TrajectoryOptimizationConfig,
            "own_schema": OwnPlannerConfig,
        },
        "hydra/sweeper": {"search_schema": SearchConfig},
    }
    for group, schemas in groups.items():
        for name, node in schemas.items():
            store.store(group=group, name=name, node=node)
