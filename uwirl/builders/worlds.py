"""Worlds from settings: scenario, channel, the relay environment, random layouts."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import torch
from torch import Tensor

from uwirl.config.make import make
from uwirl.config.schema import ChannelConfig, Config
from uwirl.motion.targets import mean_channel_targets
from uwirl.world.absorption import Water
from uwirl.world.acoustics import Channel
from uwirl.world.current import Current
from uwirl.world.layouts import Layouts, draw_layouts
from uwirl.world.obstacles import Obstacles, no_obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario, spread_sensors
from uwirl.world.vehicle import Dynamics


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
        hearing_range=scenario.hearing_range_m,
        detection_range=scenario.detection_range_m,
        vehicle_radius=scenario.vehicle_radius_m,
        dt=scenario.dt_s,
        message_period=scenario.message_period_s,
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


def make_channel(config: ChannelConfig) -> Channel:
    channel: Channel = make(config, water=Water(**asdict(config.water)))
    return channel


def _make_vehicle(config: Config) -> Dynamics:
    vehicle: Dynamics = make(config.vehicle, dtype=getattr(torch, config.dtype), device=config.device)
    return vehicle


def make_relay(config: Config, streams: RandomStreams | None = None) -> Relay:
    """The environment; one world of the configured seed unless other streams are given."""
    streams = streams or RandomStreams.worlds(config.seed, 1, config.device)
    return Relay(make_scenario(config), _make_vehicle(config), make_channel(config.channel), streams)


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
