"""The guard against an adversary at full thrust, and what it promises a well-behaved policy."""

import math
from dataclasses import asdict, replace

import pytest
import torch

from uwirl.motion.safety import EnergyGuard
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.vehicle import Vehicle, VehicleState

GUARD = EnergyGuard(
    margin_m=0.1, separation_m=1.0, alpha=2.0, mass_upper_kg=30.0, mass_lower_kg=12.0, brake_force_N=80.0
)
WORLDS = 160


def cluttered(env: Relay, worlds: int, velocity: float = 0.0, seed: int = 0) -> Relay:
    """Three to seven cylinders around the origin of each world, overlapping as they come, none within 1.2 m of it."""
    streams = RandomStreams.worlds(seed, worlds)
    u = streams.uniform(Stream.INITIAL_STATE, 0, 5 * 7).view(worlds, 7, 5)
    radius = 0.5 + 2.0 * u[..., 0]
    distance = radius + 1.2 + 5.0 * u[..., 1]
    angle = 2.0 * math.pi * u[..., 2]
    centre = distance[..., None] * torch.stack([torch.cos(angle), torch.sin(angle)], -1)
    drift = 2.0 * math.pi * u[..., 3]
    present = torch.arange(7) < 3 + (5 * u[:, :1, 4]).long()
    speed = velocity * torch.stack([torch.cos(drift), torch.sin(drift)], -1)
    scenario = replace(env.scenario, obstacles=Obstacles(centre, radius, radius + 4.0, speed, present))
    return Relay(scenario, env.vehicle, env.channel, streams)


def scaled(env: Relay, mass: float, make_config) -> Relay:
    """The same environment with a vehicle of so many times the mass and added mass."""
    settings = asdict(make_config().vehicle)
    settings |= {
        "mass_kg": mass * settings["mass_kg"],
        "added_mass": [mass * a for a in settings["added_mass"][:3]] + [0.12],
    }
    return Relay(env.scenario, Vehicle(**settings), env.channel, env.streams)


def adversary(env: Relay):
    """Full thrust towards the nearest obstacle, swerving, with yaw at full moment to and fro."""
    u = env.streams.uniform(Stream.EXPLORATION, 0, 64)

    def policy(state: VehicleState, step: int) -> torch.Tensor:
        offset = env.scenario.obstacles.offset(state.position, step * env.scenario.dt)[:, 0]
        gap = env.scenario.obstacles.clearance(state.position, 0.3, step * env.scenario.dt)[:, 0]
        towards = -offset[torch.arange(env.worlds), gap.argmin(-1)]
        swerve = 2.0 * (u[:, (step // 40) % 64] - 0.5)
        angle = torch.atan2(towards[:, 1], towards[:, 0]) + swerve - state.eta[:, 0, 3]
        yaw = torch.where(u[:, (step // 60 + 7) % 64] > 0.5, 26.0, -26.0)
        tau = torch.stack([120.0 * torch.cos(angle), 120.0 * torch.sin(angle), torch.zeros_like(angle), yaw], -1)
        return tau[:, None]

    return policy


def smallest_clearance(env: Relay, guard: EnergyGuard, seconds: float = 40.0) -> float:
    start = torch.zeros(env.worlds, 1, 4, dtype=torch.float64)
    trajectory = env.rollout(
        guard(env, adversary(env)), VehicleState.from_eta_nu(start), round(seconds / env.scenario.dt)
    )
    return float(env.scenario.clearance(trajectory.states.position, trajectory.time[:, None]).min())


def test_adversary_keeps_the_margin(make_relay):
    env = cluttered(make_relay(), WORLDS)
    assert smallest_clearance(env, GUARD) >= GUARD.margin_m - 0.01


def test_without_a_guard_the_adversary_hits(make_relay):
    env = cluttered(make_relay(), WORLDS)
    start = VehicleState.from_eta_nu(torch.zeros(WORLDS, 1, 4, dtype=torch.float64))
    trajectory = env.rollout(adversary(env), start, 200)
    assert float(env.scenario.clearance(trajectory.states.position).min()) < -0.3


@pytest.mark.parametrize(("mass", "lower", "upper"), [(1 / 3, 5.0, 30.0), (3.0, 12.0, 80.0)])
def test_adversary_in_a_vehicle_of_another_mass(make_relay, make_config, mass, lower, upper):
    """The guard knows no model, only bounds; these cover the truth."""
    env = scaled(cluttered(make_relay(), WORLDS), mass, make_config)
    guard = replace(GUARD, mass_lower_kg=lower, mass_upper_kg=upper)
    assert smallest_clearance(env, guard) >= GUARD.margin_m - 0.01


def test_a_slow_policy_far_from_everything_is_left_alone(make_relay):
    env = cluttered(make_relay(), 8)
    state = VehicleState.from_eta_nu(torch.full((8, 1, 4), 60.0, dtype=torch.float64))
    tau = 30.0 * torch.randn(8, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wanted = env.vehicle.saturate(tau)
    torch.testing.assert_close(GUARD(env, lambda *_: tau)(state, 0), wanted, rtol=0, atol=0)


def test_free_water_has_no_guard(make_relay):
    def policy(state, step):
        return state.nu

    assert GUARD(make_relay(), policy) is policy


def test_heave_and_yaw_pass_through(make_relay):
    env = cluttered(make_relay(), WORLDS)
    state = VehicleState.from_eta_nu(
        torch.zeros(WORLDS, 1, 4, dtype=torch.float64), torch.ones(WORLDS, 1, 4, dtype=torch.float64)
    )
    tau = torch.tensor([85.0, -85.0, 33.0, -7.0], dtype=torch.float64).expand(WORLDS, 1, 4)
    guarded = GUARD(env, lambda *_: tau)(state, 0)
    assert torch.equal(guarded[..., 2:], tau[..., 2:])
    assert (guarded[..., :2].abs() <= 85.0).all()
    assert not torch.equal(guarded[..., :2], tau[..., :2])


def test_turning_the_world_turns_the_answer(make_relay):
    """Body forces do not change when obstacles, pose and heading turn together."""
    env = cluttered(make_relay(), 32)
    turn = 1.1
    c, s = math.cos(turn), math.sin(turn)
    rotation = torch.tensor([[c, -s], [s, c]], dtype=torch.float64)
    obstacles = env.scenario.obstacles
    turned = Relay(
        replace(env.scenario, obstacles=replace(obstacles, centre=obstacles.centre @ rotation.T)),
        env.vehicle,
        env.channel,
        env.streams,
    )
    eta = 0.2 * torch.randn(32, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    nu = torch.randn(32, 1, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    eta_turned = torch.cat([eta[..., :2] @ rotation.T, eta[..., 2:3], eta[..., 3:] + turn], -1)
    tau = torch.tensor([60.0, 30.0, 0.0, 0.0], dtype=torch.float64).expand(32, 1, 4)
    torch.testing.assert_close(
        GUARD(env, lambda *_: tau)(VehicleState.from_eta_nu(eta, nu), 0),
        GUARD(turned, lambda *_: tau)(VehicleState.from_eta_nu(eta_turned, nu), 0),
        rtol=0,
        atol=1e-9,
    )
