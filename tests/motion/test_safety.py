"""The contract of every guard, and the energy guard against adversaries at full thrust."""

import math
from dataclasses import replace

import pytest
import torch
from scipy import optimize

from uwirl import build
from uwirl.irl.networks import LinearActor
from uwirl.motion.barrier import nearest_force
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.safety import EnergyGuard, Limits
from uwirl.world.agent import Feedback, Guard, Guarded
from uwirl.world.current import Current
from uwirl.world.observation import Observation
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.trajectory import WorldState
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Vehicle, VehicleState

GUARD = EnergyGuard(
    Limits(torch.tensor([85.0, 85.0, 120.0, 26.0], dtype=torch.float64), dt=0.05, vehicle_radius=0.3),
    margin_m=0.1,
    separation_m=1.0,
    alpha=2.0,
    mass_upper_kg=30.0,
    mass_lower_kg=12.0,
    brake_force_N=80.0,
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
    return env.on(scenario, streams)


def scaled(env: Relay, mass: float, make_config) -> Relay:
    """The same environment with a vehicle of so many times the mass and added mass."""
    settings = make_config().vehicle.values()
    settings |= {
        "mass_kg": mass * settings["mass_kg"],
        "added_mass": [mass * a for a in settings["added_mass"][:3]] + [0.12],
    }
    return Relay(env.scenario, Vehicle(**settings), truth_of(env).channel, env.streams)


def at_rest(env: Relay, M: int = 1) -> WorldState:
    """At the origin of each world."""
    return WorldState.of(VehicleState.from_eta_nu(torch.zeros(env.worlds, M, 4, dtype=torch.float64)))


def adversary(env: Relay) -> Feedback:
    """Full thrust towards the nearest obstacle, swerving, with yaw at full moment to and fro."""
    u = env.streams.uniform(Stream.EXPLORATION, 0, 64)

    def law(observation: Observation) -> torch.Tensor:
        step, time = int(observation.step[0]), observation.time
        offset = env.scenario.obstacles.offset(observation.position, time)[:, 0]
        gap = env.scenario.obstacles.clearance(observation.position, 0.3, time)[:, 0]
        towards = -offset[torch.arange(env.worlds), gap.argmin(-1)]
        swerve = 2.0 * (u[:, (step // 40) % 64] - 0.5)
        angle = torch.atan2(towards[:, 1], towards[:, 0]) + swerve - observation.eta[:, 0, 3]
        yaw = torch.where(u[:, (step // 60 + 7) % 64] > 0.5, 26.0, -26.0)
        tau = torch.stack([120.0 * torch.cos(angle), 120.0 * torch.sin(angle), torch.zeros_like(angle), yaw], -1)
        return tau[:, None]

    return Feedback(law)


def smallest_clearance(env: Relay, guard: EnergyGuard, seconds: float = 40.0) -> float:
    trajectory = env.rollout(Guarded(adversary(env), guard), at_rest(env), round(seconds / env.scenario.dt))
    return float(env.scenario.clearance(trajectory.states.position, trajectory.time[:, None]).min())


def test_adversary_keeps_the_margin(make_relay):
    env = cluttered(make_relay(), WORLDS)
    assert smallest_clearance(env, GUARD) >= GUARD.margin_m - 0.01


def test_without_a_guard_the_adversary_hits(make_relay):
    env = cluttered(make_relay(), WORLDS)
    trajectory = env.rollout(adversary(env), at_rest(env), 200)
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
    env = env.on(scenario, env.streams)
    assert smallest_clearance(env, replace(GUARD, brake_force_N=60.0)) >= GUARD.margin_m - 0.01


def test_adversary_among_drifting_obstacles_that_it_sees_at_3_m(make_relay):
    """A drifting obstacle can run a vehicle down against another one, so here is one in each world."""
    env = cluttered(make_relay(), WORLDS, velocity=0.4)
    present = torch.zeros_like(env.scenario.obstacles.present)
    present[:, 0] = True
    scenario = replace(env.scenario, obstacles=env.scenario.obstacles._replace(present=present), detection_range=3.0)
    env = env.on(scenario, env.streams)
    assert smallest_clearance(env, GUARD) >= GUARD.margin_m - 0.03


def test_vehicles_that_attack_each_other_keep_their_distance(make_relay):
    """Each at full thrust towards its nearest neighbour, in three dimensions, four to a world."""
    env = make_relay(streams=RandomStreams.worlds(0, 64))
    u = env.streams.uniform(Stream.INITIAL_STATE, 0, 12).view(64, 4, 3) - 0.5
    corners = torch.tensor([[-3.0, -3.0, -8.0], [3.0, -3.0, -10.0], [3.0, 3.0, -8.0], [-3.0, 3.0, -10.0]])
    start = torch.cat([corners + u, 6.0 * u[..., :1]], -1)
    env = env.on(replace(env.scenario, start=start), env.streams)

    def distances(position):
        apart = torch.linalg.vector_norm(position[..., :, None, :] - position[..., None, :, :], dim=-1)
        return apart + 1e3 * torch.eye(4, dtype=apart.dtype)

    def attack(observation: Observation) -> torch.Tensor:
        position = observation.position
        nearest = distances(position).argmin(-1)
        towards = position.gather(-2, nearest[..., None].expand(-1, -1, 3)) - position
        angle = torch.atan2(towards[..., 1], towards[..., 0]) - observation.eta[..., 3]
        heave = 120.0 * torch.sign(towards[..., 2])
        return torch.stack([120.0 * torch.cos(angle), 120.0 * torch.sin(angle), heave, 5.0 * torch.sin(angle)], -1)

    flown = env.rollout(Guarded(Feedback(attack), GUARD), steps=400)
    assert distances(flown.states.position).min() >= GUARD.separation_m - 0.02
    assert distances(env.rollout(Feedback(attack), steps=100).states.position).min() < 0.6


@pytest.fixture(params=["energy", "barrier"])
def guard(request, make_config, make_relay) -> Guard:
    return build.make_guard(make_config(f"safety={request.param}"), make_relay())


def test_slow_control_far_from_everything_is_left_alone(make_relay, guard):
    env = cluttered(make_relay(), 8)
    state = WorldState.of(VehicleState.from_eta_nu(torch.full((8, 1, 4), 60.0, dtype=torch.float64)))
    tau = 30.0 * torch.randn(8, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    wanted = env.vehicle.saturate(tau)
    torch.testing.assert_close(guard(tau, env.observe(state)), wanted, rtol=0, atol=0)


def test_free_water_has_no_guard(make_relay, guard):
    _, observation = make_relay("experiment=fig5_free").reset()
    tau = torch.full((1, 1, 4), 1e3, dtype=torch.float64)
    assert guard(tau, observation) is tau


def test_heave_and_yaw_pass_through(make_relay, guard):
    env = cluttered(make_relay(), WORLDS)
    zero = torch.zeros(WORLDS, 1, 4, dtype=torch.float64)
    observation = env.observe(WorldState.of(VehicleState.from_eta_nu(zero, zero + 1.0)))
    tau = torch.tensor([85.0, -85.0, 33.0, -7.0], dtype=torch.float64).expand(WORLDS, 1, 4)
    guarded = guard(tau, observation)
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
    turned_obstacles = obstacles._replace(centre=obstacles.centre @ rotation.T)
    turned = env.on(replace(env.scenario, obstacles=turned_obstacles), env.streams)
    eta = 0.2 * torch.randn(32, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    nu = torch.randn(32, 1, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    eta_turned = torch.cat([eta[..., :2] @ rotation.T, eta[..., 2:3], eta[..., 3:] + turn], -1)
    tau = torch.tensor([60.0, 30.0, 0.0, 0.0], dtype=torch.float64).expand(32, 1, 4)
    torch.testing.assert_close(
        guard(tau, env.observe(WorldState.of(VehicleState.from_eta_nu(eta, nu)))),
        guard(tau, turned.observe(WorldState.of(VehicleState.from_eta_nu(eta_turned, nu)))),
        rtol=0,
        atol=1e-9,
    )


def test_a_guarded_flight_straight_at_an_obstacle_stops_before_it(make_relay, guard):
    """No adversary: proportional to the distance of a target behind a cylinder."""
    cylinder = "scenario.obstacles=[{center_m:[10,0],radius_m:2,influence_m:6}]"
    env = make_relay("scenario.start=[[0,0,-8,0]]", cylinder)
    pull, target = torch.tensor([[4.0, 4.0, 4.0, 0.0], [20.0, 0.0, -8.0, 0.0]], dtype=torch.float64)
    pulled = Feedback(lambda observation: pull * (target - observation.eta))

    def smallest_gap(agent) -> float:
        return float(env.scenario.clearance(env.rollout(agent, steps=1200).states.position).min())

    assert 0.09 <= smallest_gap(Guarded(pulled, guard)) < 0.5
    assert smallest_gap(pulled) < 0.0


def test_one_guard_serves_an_agent_a_users_law_and_raw_actions(make_mission, guard):
    """Two vehicles that meet beside an obstacle: the same tau at every step, whoever holds the guard."""
    cylinder = "scenario.obstacles=[{center_m:[10,3.5],radius_m:2,influence_m:6}]"
    mission = make_mission("scenario.start=[[10,-2,-8,1.6],[10,8,-8,-1.6]]", cylinder)
    env, basis = mission.env, LinkFrameBasis(mission.cost, [2.0, math.inf])
    actor = LinearActor(basis, 4.0 * basis.start_weights()[None])
    frame = mission.targets.frame._replace(target=mission.targets.frame.target.flip(0))
    agent = LinkController(frame, actor, env.vehicle.trim.double())
    user = Feedback(lambda observation: agent.control(observation))
    flown, same = (env.rollout(Guarded(own, guard), steps=100) for own in (agent, user))
    assert torch.equal(flown.tau, same.tau)
    assert not torch.equal(flown.tau, env.rollout(agent, steps=100).tau)
    state, observation = env.reset()
    for k in range(100):
        tau = guard(agent.control(observation), observation)
        assert torch.equal(env.vehicle.saturate(tau), flown.tau[k])
        state, observation = env.step(state, tau)
    assert torch.equal(state.components, flown.components[-1])


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
