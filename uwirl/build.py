"""The one place where names in a configuration become objects."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import torch
from torch import Tensor

from uwirl.config.schema import (
    BarrierGuardConfig,
    Config,
    CostConfig,
    EnergyGuardConfig,
    ExperienceConfig,
    GeodesicConfig,
    GuardConfig,
    IrlConfig,
    LeastSquaresSolverConfig,
    ParallelConfig,
    PdConfig,
    PlannerConfig,
    PotentialFieldConfig,
    PrintedCostConfig,
    RlsSolverConfig,
    TrajectoryOptimizationConfig,
    VirtualLinksConfig,
)
from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.least_squares import Regularisation
from uwirl.irl.policy_iteration import StoppingRule
from uwirl.irl.solvers import BatchLeastSquares, Bounds, ClassicalRls, Solver, ZRecursiveLeastSquares
from uwirl.motion.avoidance import Avoidance, Printed, remark_2, smooth
from uwirl.motion.barrier import BarrierGuard
from uwirl.motion.baselines.guesses import Guess, guesses_on_the_map
from uwirl.motion.baselines.pd import PdPlanner
from uwirl.motion.baselines.potential_field import PotentialField
from uwirl.motion.baselines.trajectory_optimization import TrajectoryOptimization
from uwirl.motion.cost import RelayCost
from uwirl.motion.excitation import ArenaDraw, Excitation, PoseDraw
from uwirl.motion.experience import Parallel, VirtualLinks, Window
from uwirl.motion.features import ErrorBasis, LinkFrameBasis, MotionBasis
from uwirl.motion.geodesic_basis import GeodesicBasis, LearnedGeodesic
from uwirl.motion.guidance import Geodesic, Guidance, straight
from uwirl.motion.planner import CostFactory, ExperienceSource, IrlPlanner, Planner
from uwirl.motion.policy import Policy
from uwirl.motion.route import MapSettings
from uwirl.motion.safety import EnergyGuard, Guard, unguarded
from uwirl.motion.targets import ChainTargets, mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import ESTIMATORS, Estimator
from uwirl.world.acoustics import Channel
from uwirl.world.current import Current
from uwirl.world.layouts import Layouts, draw_layouts
from uwirl.world.obstacles import Obstacles, no_obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario, spread_sensors
from uwirl.world.vehicle import Vehicle


def make_scenario(config: Config) -> Scenario:
    scenario, dtype, device = config.scenario, getattr(torch, config.dtype), config.device

    def tensor(values: list) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    if isinstance(scenario.sensors, int):
        sensors = spread_sensors(scenario.sensors, config.seed, scenario.source_m, scenario.destination_m, dtype).to(
            device
        )
    else:
        sensors = tensor(scenario.sensors)
    return Scenario(
        source=tensor(scenario.source_m),
        destination=tensor(scenario.destination_m),
        start=tensor(scenario.start),
        sensors=sensors,
        obstacles=_obstacles(config),
        current=Current(tensor(scenario.current_mps), scenario.current_std_mps, scenario.current_time_s),
        depth=scenario.depth_m,
        detection_range=scenario.detection_range_m,
        vehicle_radius=scenario.vehicle_radius_m,
        dt=scenario.dt_s,
        duration=scenario.duration_s,
    )


def _obstacles(config: Config) -> Obstacles:
    obstacles, dtype, device = config.scenario.obstacles, getattr(torch, config.dtype), config.device
    if not obstacles:
        return no_obstacles(dtype, device)

    def tensor(values: list) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    return Obstacles(
        centre=tensor([obstacle.center_m for obstacle in obstacles]),
        radius=tensor([obstacle.radius_m for obstacle in obstacles]),
        influence=tensor([obstacle.influence_m for obstacle in obstacles]),
        velocity=tensor([obstacle.velocity_mps for obstacle in obstacles]),
        present=torch.ones(len(obstacles), dtype=torch.bool, device=device),
    )


def make_layouts(config: Config) -> tuple[Relay, Layouts]:
    """Random layouts, and the environment that they share but for starts and obstacles."""
    settings = config.scenario.layouts
    assert settings is not None
    streams = RandomStreams.worlds(settings.seed, settings.count, config.device)
    env = make_relay(config, streams)
    targets = mean_channel_targets(env.scenario, env.channel).frame.target
    layouts = draw_layouts(streams, settings.kinds, targets, settings.half_width_m, env.scenario.vehicle_radius)
    bearing = 2.0 * math.pi * streams.uniform(Stream.DISTURBANCE, 1, 1)[:, 0]
    side = torch.stack([torch.cos(bearing), torch.sin(bearing), torch.zeros_like(bearing)], -1).to(targets.dtype)
    current = env.scenario.current
    current = replace(current, mean=current.mean + settings.current_mps * side)
    return Relay(replace(env.scenario, current=current), env.vehicle, env.channel, streams), layouts


def make_guard(config: Config) -> Guard:
    """What stands between policy and thrusters."""
    safety = config.safety
    if isinstance(safety, BarrierGuardConfig):
        u, v, w = safety.inertia_kg
        return BarrierGuard(safety.margin_m, safety.separation_m, safety.k_1, safety.k_0, (u, v, w))
    if not isinstance(safety, EnergyGuardConfig):
        return unguarded
    return EnergyGuard(
        safety.margin_m,
        safety.separation_m,
        safety.alpha,
        safety.mass_upper_kg,
        safety.mass_lower_kg,
        safety.brake_force_N,
    )


def make_guidance(config: Config) -> Guidance:
    """How missions are led to their targets."""
    guidance = config.guidance
    if not isinstance(guidance, GeodesicConfig):
        return straight
    return Geodesic(
        guidance.gain,
        guidance.lateral_damping,
        guidance.heading_stiffness,
        guidance.heading_damping,
        config.safety.margin_m if isinstance(config.safety, GuardConfig) else 0.0,
        MapSettings(guidance.spacing_m, guidance.exponent, guidance.hard_clearance_m),
    )


def make_relay(config: Config, streams: RandomStreams | None = None) -> Relay:
    """The environment; one world of the configured seed unless other streams are given."""
    vehicle = Vehicle(**asdict(config.vehicle), dtype=getattr(torch, config.dtype), device=config.device)
    streams = streams or RandomStreams.worlds(config.seed, 1, config.device)
    return Relay(make_scenario(config), vehicle, Channel(**asdict(config.channel)), streams)


def make_estimator(config: Config) -> Estimator:
    return ESTIMATORS[config.estimator.name]


def make_cost(config: CostConfig, channel: Channel, targets: ChainTargets, tau_max: Tensor) -> RelayCost:
    """The running cost on a channel: the estimate to learn from, the truth to be judged by."""
    avoidance: Avoidance = smooth
    if isinstance(config, PrintedCostConfig):
        avoidance = Printed(*remark_2(config.left_m, config.right_m, config.kappa_1, config.kappa_2))
    return RelayCost(
        channel, targets.neighbours, config.beta_1, config.beta_2, config.yaw_weight, config.R, tau_max, avoidance
    )


def make_planner(config: Config, planner: PlannerConfig, env: Relay) -> Planner:
    """A planner with these settings; it learns one set of weights for each world of `env`."""

    def cost(channel: Channel, targets: ChainTargets) -> RelayCost:
        return make_cost(config.cost, channel, targets, env.vehicle.tau_max)

    if isinstance(planner, PdConfig):
        pd = PdPlanner(
            cost,
            planner.position_gain,
            planner.velocity_gain,
            planner.saturation_m,
            planner.calibration_s,
            make_guard(config),
            # A field leads by itself.
            straight if isinstance(planner, PotentialFieldConfig) else make_guidance(config),
        )
        return (
            PotentialField(pd, planner.repulsion, planner.reach_m) if isinstance(planner, PotentialFieldConfig) else pd
        )
    if isinstance(planner, TrajectoryOptimizationConfig):

        def guesses(worlds: Relay, running_cost: RelayCost, targets: ChainTargets) -> list[Guess]:
            return guesses_on_the_map(worlds, running_cost, targets, planner.speeds_mps, planner.intervals)

        return TrajectoryOptimization(cost, guesses, planner.intervals)
    assert isinstance(planner, IrlConfig)
    return _irl_planner(config, planner, env, cost)


def policy_in(worlds: Relay, config: Config, planner: Planner, estimate: ChannelEstimate) -> Policy:
    """What a planner has found, in other worlds between the same nodes."""
    if not isinstance(planner, IrlPlanner):
        return planner.fit(worlds, estimate)
    targets = mean_channel_targets(worlds.scenario, estimate.channel)
    cost = make_cost(config.cost, estimate.channel, targets, worlds.vehicle.tau_max)
    return planner.guidance(worlds, cost, targets)(planner.policy)


def _irl_planner(config: Config, planner: IrlConfig, env: Relay, cost: CostFactory) -> IrlPlanner:
    dt = config.scenario.dt_s

    def solver(operator: BellmanOperator, weights: Tensor, bounds: Bounds) -> Solver:
        settings = config.solver
        if isinstance(settings, RlsSolverConfig):
            form = "paper" if settings.name == "rls_paper" else "exponential"
            return ClassicalRls(operator, weights, settings.kappa, settings.p0, form)
        assert isinstance(settings, LeastSquaresSolverConfig)
        family = ZRecursiveLeastSquares if settings.name == "z_rls" else BatchLeastSquares
        regularisation = Regularisation(settings.ridge, settings.prior)
        return family(operator, regularisation, bounds if settings.bounded else None)

    return IrlPlanner(
        make_cost=cost,
        make_basis=lambda running_cost: _basis(config, running_cost),
        make_solver=solver,
        experience=_experience(config),
        learners=1 if isinstance(config.experience, ParallelConfig) else env.worlds * env.scenario.vehicles,
        actor_sign=-1.0 if planner.actor_sign == "corrected" else 1.0,
        inertia_lower=tuple(planner.inertia_lower),
        start_gain=planner.start_gain,
        calibration_s=planner.calibration_s,
        window=Window(round(planner.window_s / dt), round(planner.stride_s / dt)),
        residual_floor=planner.residual_floor,
        updates=planner.updates,
        stopping=StoppingRule(planner.tolerance_weights, planner.max_time_s),
        guard=make_guard(config),
        guidance=_learned_geodesic(config) if config.basis.name == "geodesic" else make_guidance(config),
    )


def _learned_geodesic(config: Config) -> LearnedGeodesic:
    guidance = make_guidance(config)
    assert isinstance(guidance, Geodesic)
    return LearnedGeodesic(guidance.margin_m, guidance.map_settings)


def _basis(config: Config, cost: RelayCost) -> MotionBasis:
    if config.basis.name == "link_frame":
        return LinkFrameBasis(cost, config.basis.length_scales_m)
    if config.basis.name == "geodesic":
        return GeodesicBasis(cost, config.basis.length_scales_m, _learned_geodesic(config))
    return ErrorBasis(velocity=config.basis.name == "error_velocity")


def _experience(config: Config) -> ExperienceSource:
    experience = config.experience
    excitation = Excitation(
        tuple(experience.excitation_rms),
        (experience.excitation_strength[0], experience.excitation_strength[1]),
        (experience.excitation_band_rad_s[0], experience.excitation_band_rad_s[1]),
    )
    pose = _pose_draw(config, experience)
    if isinstance(experience, ParallelConfig):
        return Parallel(experience.worlds, experience.leg_s, excitation, pose)
    assert isinstance(experience, VirtualLinksConfig)
    return VirtualLinks(experience.leg_s, experience.relabel, experience.relabel_time_s, excitation, pose)


def _pose_draw(config: Config, experience: ExperienceConfig) -> PoseDraw:
    """Virtual links reach 5 % further than half the real one, and than the mission's start in each direction."""
    source, destination = config.scenario.source_m, config.scenario.destination_m
    half = [(b - a) / 2.0 for a, b in zip(source, destination, strict=True)]
    bearing = math.atan2(half[1], half[0])
    c, s = math.cos(bearing), math.sin(bearing)
    errors = [[p - a - h for p, a, h in zip(eta[:3], source, half, strict=True)] for eta in config.scenario.start]
    along = 1.05 * max(math.hypot(*half), *(abs(c * x + s * y) for x, y, _ in errors))
    family = ArenaDraw if config.basis.name == "geodesic" else PoseDraw
    return family(
        along_m=along,
        across_m=max(experience.across_share * along, *(1.05 * abs(c * y - s * x) for x, y, _ in errors)),
        up_m=max(experience.up_m, *(1.05 * abs(z) for _, _, z in errors)),
        yaw_rad=experience.yaw_rad,
        near_share=experience.near_share,
        near_scale=experience.near_scale,
    )
