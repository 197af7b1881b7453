"""The contract of every guard, and the energy guard against adversaries at full thrust."""

import math
from dataclasses import replace

import pytest
import torch
from scipy import optimize

from uwirl import build
from uwirl.motion.barrier import nearest_force
from uwirl.motion.safety import EnergyGuard
from uwirl.world.current import Current
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
    settings = make_config().vehicle.values()
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


@pytest.mark.parametrize(("speed", "spread"), [(0.3, 0.0), (0.2, 0.05)])
def test_adversary_in_a_current(make_relay, speed, spread):
    """0.3 m/s from another side in each world, part of it Gauss-Markov at two deviations; 60 N are left for braking."""
    env = cluttered(make_relay(), WORLDS)
    bearing = env.streams.uniform(Stream.DISTURBANCE, 1, 1)[:, 0] * 2.0 * math.pi
    mean = speed * torch.stack([torch.cos(bearing), torch.sin(bearing), torch.zeros_like(bearing)], -1)
    scenario = replace(env.scenario, current=Current(mean, spread, 60.0))
    env = Relay(scenario, env.vehicle, env.channel, env.streams)
    assert smallest_clearance(env, replace(GUARD, brake_force_N=60.0)) >= GUARD.margin_m - 0.01


def test_adversary_among_drifting_obstacles_that_it_sees_at_3_m(make_relay):
    """A drifting obstacle can run a vehicle down against another one, so here is one in each world."""
    env = cluttered(make_relay(), WORLDS, velocity=0.4)
    present = torch.zeros_like(env.scenario.obstacles.present)
    present[:, 0] = True
    scenario = replace(env.scenario, obstacles=replace(env.scenario.obstacles, present=present), detection_range=3.0)
    env = Relay(scenario, env.vehicle, env.channel, env.streams)
    assert smallest_clearance(env, GUARD) >= GUARD.margin_m - 0.03


def test_vehicles_that_attack_each_other_keep_their_distance(make_relay):
    """Each at full thrust towards its nearest neighbour, in three dimensions, four to a world."""
    env = make_relay(streams=RandomStreams.worlds(0, 64))
    u = env.streams.uniform(Stream.INITIAL_STATE, 0, 12).view(64, 4, 3) - 0.5
    corners = torch.tensor([[-3.0, -3.0, -8.0], [3.0, -3.0, -10.0], [3.0, 3.0, -8.0], [-3.0, 3.0, -10.0]])
    start = torch.cat([corners + u, 6.0 * u[..., :1]], -1)
    env = Relay(replace(env.scenario, start=start), env.vehicle, env.channel, env.streams)

    def distances(position):
        apart = torch.linalg.vector_norm(position[..., :, None, :] - position[..., None, :, :], dim=-1)
        return apart + 1e3 * torch.eye(4, dtype=apart.dtype)

    def attack(state: VehicleState, step: int) -> torch.Tensor:
        nearest = distances(state.position).argmin(-1)
        towards = state.position.gather(-2, nearest[..., None].expand(-1, -1, 3)) - state.position
        angle = torch.atan2(towards[..., 1], towards[..., 0]) - state.eta[..., 3]
        heave = 120.0 * torch.sign(towards[..., 2])
        return torch.stack([120.0 * torch.cos(angle), 120.0 * torch.sin(angle), heave, 5.0 * torch.sin(angle)], -1)

    flown = env.rollout(GUARD(env, attack), env.reset(), 400)
    assert distances(flown.states.position).min() >= GUARD.separation_m - 0.02
    assert distances(env.rollout(attack, env.reset(), 100).states.position).min() < 0.6


@pytest.fixture(params=["energy", "barrier"])
def guard(request, make_config):
    return build.make_guard(make_config(f"safety={request.param}"))


def test_a_slow_policy_far_from_everything_is_left_alone(make_relay, guard):
    env = cluttered(make_relay(), 8)
    state = VehicleState.from_eta_nu(torch.full((8, 1, 4), 60.0, dtype=torch.float64))
    tau = 30.0 * torch.randn(8, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wanted = env.vehicle.saturate(tau)
    torch.testing.assert_close(guard(env, lambda *_: tau)(state, 0), wanted, rtol=0, atol=0)


def test_free_water_has_no_guard(make_relay, guard):
    def policy(state, step):
        return state.nu

    assert guard(make_relay("experiment=fig5_free"), policy) is policy


def test_heave_and_yaw_pass_through(make_relay, guard):
    env = cluttered(make_relay(), WORLDS)
    state = VehicleState.from_eta_nu(
        torch.zeros(WORLDS, 1, 4, dtype=torch.float64), torch.ones(WORLDS, 1, 4, dtype=torch.float64)
    )
    tau = torch.tensor([85.0, -85.0, 33.0, -7.0], dtype=torch.float64).expand(WORLDS, 1, 4)
    guarded = guard(env, lambda *_: tau)(state, 0)
    assert torch.equal(guarded[..., 2:], tau[..., 2:])
    assert (guarded[..., :2].abs() <= 85.0).all()
    assert not torch.equal(guarded[..., :2], tau[..., :2])


def test_turning_the_world_turns_the_answer(make_relay, guard):
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
        guard(env, lambda *_: tau)(VehicleState.from_eta_nu(eta, nu), 0),
        guard(turned, lambda *_: tau)(VehicleState.from_eta_nu(eta_turned, nu), 0),
        rtol=0,
        atol=1e-9,
    )


def test_a_guarded_flight_straight_at_an_obstacle_stops_before_it(make_relay, guard):
    """A policy, not an adversary: proportional to the distance of a target behind a cylinder."""
    cylinder = "scenario.obstacles=[{center_m:[10,0],radius_m:2,influence_m:6}]"
    env = make_relay("scenario.start=[[0,0,-8,0]]", cylinder)
    pull = torch.tensor([4.0, 4.0, 4.0, 0.0], dtype=torch.float64)

    def policy(state, step):
        return pull * (torch.tensor([20.0, 0.0, -8.0, 0.0], dtype=torch.float64) - state.eta)

    flown = env.rollout(guard(env, policy), env.reset(), 1200)
    gap = env.scenario.clearance(flown.states.position)
    assert 0.09 <= float(gap.min()) < 0.5
    assert float(env.scenario.clearance(env.rollout(policy, env.reset(), 1200).states.position).min()) < 0.0


@pytest.mark.parametrize("seed", range(20))
def test_barrier_solves_the_quadratic_program(seed):
    """Against SciPy's general solver, on random half-planes through the box."""
    random = torch.Generator().manual_seed(seed)
    limit = torch.tensor([85.0, 85.0], dtype=torch.float64)
    wanted = 120.0 * torch.randn(2, generator=random, dtype=torch.float64)
    wanted = torch.minimum(torch.maximum(wanted, -limit), limit)
    normal = torch.randn(4, 2, generator=random, dtype=torch.float64)
    least = normal @ (120.0 * torch.rand(2, generator=random, dtype=torch.float64) - 60.0) - 5.0
    found = nearest_force(wanted, normal, least, limit)
    # In units of the limit, or the solver's line search fails now and then.
    solved = optimize.minimize(
        lambda f: ((85.0 * f - wanted.numpy()) ** 2).sum() / 85.0**2,
        torch.zeros(2).numpy(),
        method="SLSQP",
        bounds=[(-1.0, 1.0)] * 2,
        constraints=[optimize.LinearConstraint(normal.numpy(), least.numpy() / 85.0, math.inf)],
        options={"ftol": 1e-14},
    )
    assert (normal @ torch.tensor(85.0 * solved.x) >= least - 1e-6).all()
    torch.testing.assert_close(found, torch.tensor(85.0 * solved.x), rtol=0, atol=1e-3)


def test_barrier_without_a_solution_stays_within_the_limits():
    limit = torch.tensor([85.0, 85.0], dtype=torch.float64)
    normal = torch.tensor([[1.0, 0.0], [-1.0, 0.0]], dtype=torch.float64)
    least = torch.tensor([50.0, 30.0], dtype=torch.float64)
    found = nearest_force(torch.tensor([-85.0, 20.0], dtype=torch.float64), normal, least, limit)
    assert (found.abs() <= limit).all()
    assert float((least - normal @ found).max()) <= 80.0
