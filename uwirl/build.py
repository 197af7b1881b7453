"""Objects from a configuration; `uwirl.config.make` makes those whose class the configuration names."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from uwirl.config.custom import found, taken
from uwirl.config.make import make, takes
from uwirl.config.schema import ChannelConfig, Config, CostConfig, EstimatorConfig, GuardConfig, PlannerConfig
from uwirl.motion.avoidance import smooth
from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.features import MotionBasis
from uwirl.motion.guidance import Geodesic, Guidance
from uwirl.motion.planner import Planner
from uwirl.motion.route_view import LearnedGeodesic
from uwirl.motion.safety import Limits
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import Estimator
from uwirl.snr.outliers import reject_outliers
from uwirl.study.evaluation import Evaluator
from uwirl.world.absorption import Water
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.agent import Guard, check_shape
from uwirl.world.current import Current
from uwirl.world.geometry import unit_vector
from uwirl.world.layouts import Layouts, draw_layouts
from uwirl.world.navigation import Navigation
from uwirl.world.obstacles import Obstacles, no_obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario, spread_sensors
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Dynamics, VehicleState


def make_scenario(config: Config) -> Scenario:
    """Nodes, vehicles, sensors, obstacles and water, on the configured device."""
    scenario, dtype = config.scenario, getattr(torch, config.dtype)
    tensor = partial(torch.tensor, dtype=dtype, device=config.device)
    if isinstance(scenario.sensors, int):
        spread = spread_sensors(scenario.sensors, config.seed, scenario.source_m, scenario.destination_m, dtype)
        sensors = spread.to(config.device)
    else:
        sensors = tensor(scenario.sensors)
    return Scenario(
        source=tensor(scenario.source_m),
        destination=tensor(scenario.destination_m),
        start=tensor(scenario.start),
        sensors=sensors,
        obstacles=_obstacles(config, tensor),
        current=Current(tensor(scenario.current_mps), scenario.current_std_mps, scenario.current_time_s),
        depth=scenario.depth_m,
        hearing_range=scenario.hearing_range_m,
        detection_range=scenario.detection_range_m,
        vehicle_radius=scenario.vehicle_radius_m,
        dt=scenario.dt_s,
        message_period=scenario.message_period_s,
        duration=scenario.duration_s,
        navigation=Navigation(**asdict(scenario.navigation)),
        streaming=scenario.streaming,
    )


def _obstacles(config: Config, tensor: Callable[[list], Tensor]) -> Obstacles:
    obstacles = config.scenario.obstacles
    if not obstacles:
        return no_obstacles(getattr(torch, config.dtype), config.device)
    return Obstacles(
        centre=tensor([obstacle.center_m for obstacle in obstacles]),
        radius=tensor([obstacle.radius_m for obstacle in obstacles]),
        influence=tensor([obstacle.influence_m for obstacle in obstacles]),
        velocity=tensor([obstacle.velocity_mps for obstacle in obstacles]),
        present=torch.ones(len(obstacles), dtype=torch.bool, device=config.device),
    )


def make_channel(config: ChannelConfig) -> Channel:
    """The true channel; a custom class is its link budget, or the whole channel if it extends Channel."""
    water = Water(**asdict(config.water))
    if config.target is not None and issubclass(found(config.target, "channel.target"), Channel):
        return make(config, budget=LinkBudget(**_taken_by(LinkBudget, config.values()) | {"water": water}))
    budget: LinkBudget = make(config, water=water)
    some = torch.ones(2, 3, dtype=torch.float64)
    for method in (budget.known_loss_dB, budget.capacity_kbps):
        check_shape(f"{method.__name__} of {type(budget).__name__}", method(some), some.shape, "as its argument")
    return Channel(budget, **_taken_by(Channel, config.values()))


def _taken_by(target: type, values: dict[str, Any]) -> dict[str, Any]:
    names, _ = taken(target)
    return {name: value for name, value in values.items() if name in names}


def make_relay(config: Config, streams: RandomStreams | None = None) -> Relay:
    """The environment; one world of the configured seed unless other random streams are given."""
    dtype = getattr(torch, config.dtype)
    vehicle = make(config.vehicle, dtype=dtype, device=config.device)
    _check_vehicle(vehicle, torch.zeros(8, 2, 3, dtype=dtype, device=config.device), config.scenario.dt_s)
    streams = streams or RandomStreams.worlds(config.seed, 1, config.device)
    return Relay(make_scenario(config), vehicle, make_channel(config.channel), streams, config.compile)


def _check_vehicle(vehicle: Dynamics, rest: Tensor, dt: float) -> None:
    """Whether limits, trim and a step from rest have the shapes that the world needs."""
    name, tau = type(vehicle).__name__, rest[:4].movedim(0, -1)
    for attribute in ("tau_max", "trim"):
        check_shape(f"{attribute} of {name}", getattr(vehicle, attribute), torch.Size([4]), "axis")
    check_shape(f"{name}.saturate", vehicle.saturate(tau), tau.shape)
    after = vehicle.step(VehicleState(rest), tau, dt)
    check_shape(f"{name}.step", getattr(after, "components", after), rest.shape, "component, world, vehicle")


def make_layouts(config: Config) -> tuple[Relay, Layouts]:
    """Random layouts, and the environment in which they replace starts and obstacles."""
    settings = config.scenario.layouts
    assert settings is not None
    streams = RandomStreams.worlds(settings.seed, settings.count, config.device)
    env = make_relay(config, streams)
    targets = mean_channel_targets(env.scenario, truth_of(env).channel).frame.target
    layouts = draw_layouts(streams, settings.kinds, targets, settings.half_width_m, env.scenario.vehicle_radius)
    bearing = 2.0 * math.pi * streams.uniform(Stream.DISTURBANCE, 1, 1)[:, 0]
    side = torch.nn.functional.pad(unit_vector(bearing), (0, 1)).to(targets.dtype)
    current = env.scenario.current
    current = replace(current, mean=current.mean + settings.current_mps * side)
    return env.on(replace(env.scenario, current=current), streams), layouts


def make_estimator(config: EstimatorConfig, env: Relay | None = None) -> Estimator:
    """The estimator of stage 1; `oracle` gets the true channel of an environment."""
    truth = {"channel": truth_of(env).channel} if env is not None and config.name == "oracle" else {}
    estimator: Estimator = make(config, **truth)
    if not config.robust:
        return estimator
    return lambda readings, budget: estimator(reject_outliers(readings, budget), budget)


def make_cost(config: CostConfig) -> CostWeights:
    """The weights of the running cost, by which missions are planned and evaluated."""
    return make(config, avoidance=smooth)


def make_guard(config: Config, env: Relay) -> Guard:
    """The guard between agent and thrusters."""
    return make(config.safety, Limits.of(env))


def make_guidance(config: Config) -> Guidance:
    """The guidance to the targets in missions."""
    margin = config.safety.margin_m if isinstance(config.safety, GuardConfig) else 0.0
    return make(config.guidance, margin_m=margin)


def make_planner(config: Config, planner: PlannerConfig, env: Relay) -> Planner:
    """A planner, with those of cost, guard, guidance, basis, solver and experience that its class takes by name."""
    guidance = make_guidance(config)
    learned = guidance
    if config.basis.name == "geodesic" and isinstance(guidance, Geodesic):
        learned = LearnedGeodesic(guidance.margin_m, guidance.map_settings)

    def basis(cost: RelayCost) -> MotionBasis:
        return make(config.basis, cost, ways=learned)

    return make(
        planner,
        cost=make_cost(config.cost),
        guard=make_guard(config, env),
        guidance=learned if takes(planner, "basis") else guidance,
        basis=basis,
        solver=partial(make, config.solver),
        experience=make(config.experience),
    )


def make_evaluator(config: Config, env: Relay) -> Evaluator:
    """The evaluator of missions in an environment."""
    return Evaluator(env, make_cost(config.cost), make_guard(config, env), config.logging.progress)
