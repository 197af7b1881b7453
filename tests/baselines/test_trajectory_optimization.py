"""The trajectory optimiser against reference costs, the world's own model of vehicle and cost, and its constraints."""

import math
import sys
from dataclasses import replace

import pytest
import torch
from uwirl.motion.baselines.guesses import guess_along, guess_from
from uwirl.motion.baselines.trajectory_optimization import PlanPolicy, TrajectoryOptimization, optimise

from uwirl import build
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.study.evaluation import evaluate
from uwirl.world.messages import take_readings
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Trajectory
from uwirl.world.vehicle import VehicleState

# eta at rest, and J of the same cost in free water from an optimiser written independently; the last is the paper's.
REFERENCES = [
    ((15.25, 22.61, -12.93, 1.42), 1.080),
    ((16.19, -6.38, -0.75, 1.43), 0.203),
    ((1.65, 11.59, -10.09, -1.49), 0.186),
    ((-9.19, -2.15, -9.27, 1.12), 0.111),
    ((21.62, 23.18, -9.23, -1.06), 1.616),
    ((-2.18, -11.22, -0.38, 1.47), 0.180),
    ((0.27, 3.31, -13.83, -0.26), 0.035),
    ((8.62, 6.79, -10.52, -1.25), 0.210),
    ((10.19, 25.17, -12.87, -0.59), 1.035),
    ((21.21, 34.35, -7.66, 0.40), 2.725),
    ((-0.65, 4.84, -0.84, 0.21), 0.046),
    ((-16.79, 2.76, -15.81, 1.55), 0.263),
    ((29.5, 29.5, 0.0, 1.0), 3.147),
]
PAPER = [REFERENCES[-1][0]]


@pytest.fixture
def world(make_config, make_relay):
    """world(start, overrides...): environment, cost on the true channel and targets."""

    def make(start=PAPER, *overrides: str):
        overrides = overrides or ("experiment=fig5_free",)
        config, env = make_config(*overrides), make_relay(*overrides)
        env.scenario = replace(env.scenario, start=torch.tensor(start, dtype=env.scenario.start.dtype))
        targets = mean_channel_targets(env.scenario, env.channel)
        return env, build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max), targets

    return make


@pytest.fixture
def solver():
    return pytest.importorskip("casadi")


def straight(env, targets, intervals: int = 200, turns=(False, True), world: int = 0):
    start = env.scenario.start.view(-1, env.scenario.vehicles, 4)[world]
    paths = [torch.stack([p, q]) for p, q in zip(start[:, :2], targets.frame.target[:, :2], strict=True)]
    return [guess_along(env, targets, paths, 0.8, intervals, turn, world, f"straight, turn={turn}") for turn in turns]


def round_the_obstacles(env, targets, intervals: int = 200):
    """Between the two obstacles of Fig. 5 and the axis y = x on its upper side."""
    path = torch.tensor([[29.5, 29.5], [18.4, 22.6], [6.9, 13.1], [0.0, 0.0]], dtype=torch.float64)
    return guess_along(env, targets, [path], 0.8, intervals, name="round")


def check_reference(world, start, printed):
    env, cost, targets = world([start])
    plan = optimise(env, cost, targets, straight(env, targets))
    assert all(attempt.converged for attempt in plan.attempts)
    # Printed to three decimals.
    assert plan.cost == pytest.approx(printed, rel=0.01, abs=5e-4)


@pytest.mark.parametrize(("start", "printed"), [REFERENCES[k] for k in (1, 9, 12)])
def test_reference_costs(solver, world, start, printed):
    check_reference(world, start, printed)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "printed"), REFERENCES)
def test_all_reference_costs(solver, world, start, printed):
    check_reference(world, start, printed)


@pytest.mark.parametrize("cost_name", ["relay", "paper"])
def test_plan_obeys_the_world(solver, world, cost_name):
    """Defects by Vehicle.derivative and J by RelayCost, both at the nodes."""
    env, cost, targets = world(PAPER, "experiment=fig5_single", f"cost={cost_name}")
    plan = optimise(env, cost, targets, [round_the_obstacles(env, targets)])
    assert plan.converged
    assert bool((plan.tau.abs() <= env.vehicle.tau_max + 1e-5).all())
    assert -env.scenario.depth <= float(plan.eta[..., 2].min()) <= float(plan.eta[..., 2].max()) <= 1e-6
    torch.testing.assert_close(plan.eta[0], env.scenario.start)
    assert not bool(plan.nu[0].any())

    h = env.scenario.duration / 200
    force = (plan.tau - env.vehicle.restoring).unbind(-1)
    f = torch.stack(env.vehicle.derivative(plan.eta[..., 3], plan.nu.unbind(-1), force), -1)
    x = torch.cat([plan.eta, plan.nu], -1)
    defect = x.diff(dim=0) - h / 2.0 * (f[1:] + f[:-1])
    assert float(defect.abs().max()) < 5e-3  # |nu| is rounded near rest

    state = VehicleState.from_eta_nu(plan.eta, plan.nu)
    time = h * torch.arange(201)
    q = cost.state(targets.frame.relative(state)) + cost.control(plan.tau - env.vehicle.trim)
    q = q + cost.obstacle(env.scenario.obstacles, state.position, time)
    assert plan.cost == pytest.approx(float(torch.trapezoid(q, dx=h, dim=0).sum()), rel=1e-4)


def test_planner_flies_its_plan(solver, world):
    """At full thrust the Munk moment turns a vehicle that yaws softly off its plan: J is then half as much again."""
    env, cost, targets = world()
    planner = TrajectoryOptimization(lambda channel, targets: cost, lambda env, cost, targets: straight(env, targets))
    policy = planner.fit(env, oracle(take_readings(env), env.channel))
    flown = evaluate(env, policy, cost, targets, env.reset())
    assert float(flown.cost[0]) == pytest.approx(planner.plan.cost, rel=0.02)
    off = flown.trajectory.eta[::8, 0] - planner.plan.eta
    assert float(torch.linalg.vector_norm(off[..., :3], dim=-1).max()) < 0.2
    assert flown.metrics()["capacity_final_mean_kbps"] == pytest.approx(62.045, abs=0.01)

    batch = VehicleState.from_eta_nu(env.scenario.start.expand(3, 1, 4))
    assert policy(batch, 0).shape == (3, 1, 4)
    turned = env.scenario.start + torch.tensor([0.0, 0.0, 0.0, 2.0 * math.pi], dtype=torch.float64)
    torch.testing.assert_close(policy(VehicleState.from_eta_nu(turned[None]), 0), policy(env.reset(), 0))
    at_end = VehicleState.from_eta_nu(planner.plan.eta[-1:])
    torch.testing.assert_close(policy(at_end, 10**6), env.vehicle.trim.expand(1, 1, 4))


def test_fig5_goes_round_the_obstacles(solver, world):
    env, cost, targets = world(PAPER, "experiment=fig5_single")
    guesses = [*straight(env, targets, turns=(False,)), round_the_obstacles(env, targets)]
    plan = optimise(env, cost, targets, guesses)
    assert plan.guess == "round"
    assert [attempt.name for attempt in plan.attempts] == [guess.name for guess in guesses]
    assert plan.cost == min(attempt.cost for attempt in plan.attempts)
    assert 3.147 < plan.cost <= 3.30
    assert float(env.scenario.clearance(plan.eta[..., :3]).min()) >= -1e-4
    flown = evaluate(env, PlanPolicy(env, plan), cost, targets, env.reset())
    assert float(flown.cost[0]) == pytest.approx(plan.cost, rel=0.02)
    assert float(flown.clearance.min()) > 0.0


def test_drifting_and_absent_obstacles_of_one_world_of_a_batch(solver, world):
    """World 0: a cylinder that drifts into the way. World 1: none."""
    start = [20.0, 0.0, -8.0, math.pi / 4.0]
    env, cost, targets = world([[start], [start]])
    cost.beta_2 = 0.0
    env.streams = RandomStreams.worlds(0, 2)
    centre = torch.tensor([10.0, -10.0], dtype=torch.float64).expand(2, 1, 2)
    radius = torch.full((2, 1), 2.0, dtype=torch.float64)
    velocity = torch.tensor([0.0, 0.4], dtype=torch.float64).expand(2, 1, 2)
    obstacles = Obstacles(centre, radius, 3.0 * radius, velocity, torch.tensor([[True], [False]]))
    env.scenario = replace(env.scenario, obstacles=obstacles, duration=40.0)
    plans = [
        optimise(env, cost, targets, straight(env, targets, 100, (False,), b), 100, b, max_iterations=500)
        for b in (0, 1)
    ]
    assert all(plan.converged for plan in plans)
    time = torch.linspace(0.0, 40.0, 101, dtype=torch.float64)
    gap = env.scenario.clearance(torch.stack([plan.eta for plan in plans], 1)[..., :3], time[:, None])
    assert float(gap[:, 0].min()) == pytest.approx(0.0, abs=1e-3)
    assert plans[1].cost < plans[0].cost
    free, cost, targets = world([start])
    free.scenario = replace(free.scenario, duration=40.0)
    alone = optimise(free, cost, targets, straight(free, targets, 100, (False,)), 100)
    assert plans[1].cost == pytest.approx(alone.cost, rel=1e-6)


def test_vehicles_that_swap_keep_apart(solver, world):
    """Head-on, each is to go where the other starts; at 2.6 m/s they meet between two nodes."""
    env, cost, targets = world([[12.0, 12.0, -8.0, 0.8], [-12.0, -12.0, -8.0, 0.8]])
    env.scenario = replace(env.scenario, duration=40.0)
    plan = optimise(env, cost, targets, straight(env, targets, 50, (False,)), 50)
    assert plan.converged

    def separation(eta):
        return float(torch.linalg.vector_norm(eta[..., 0, :3] - eta[..., 1, :3], dim=-1).min())

    assert separation(plan.eta) >= 1.0 - 1e-4
    flown = evaluate(env, PlanPolicy(env, plan), cost, targets, env.reset())
    assert separation(flown.trajectory.eta) >= 0.95
    assert float(flown.cost[0]) == pytest.approx(plan.cost, rel=0.02)


def test_failure_is_reported(solver, world):
    env, cost, targets = world()
    plan = optimise(env, cost, targets, straight(env, targets, 50), 50, max_iterations=1)
    assert not plan.converged
    assert [attempt.converged for attempt in plan.attempts] == [False, False]
    best = min(plan.attempts, key=lambda attempt: attempt.infeasibility)
    assert best.infeasibility > 1e-4
    assert (plan.guess, plan.cost) == (best.name, best.cost)


def test_missing_solver_is_named(monkeypatch, world):
    monkeypatch.setitem(sys.modules, "casadi", None)
    env, cost, targets = world()
    with pytest.raises(ImportError, match=r"pip install 'uwirl\[solvers\]'"):
        optimise(env, cost, targets, straight(env, targets))


def test_bad_guesses(solver, world):
    env, cost, targets = world()
    with pytest.raises(ValueError, match="at least one"):
        optimise(env, cost, targets, [])
    with pytest.raises(ValueError, match=r"straight, turn=False is not \[101, 1, 4\]"):
        optimise(env, cost, targets, straight(env, targets, 50), 100)


def test_guess_along_a_path(world):
    env, _, targets = world([[20.0, 0.0, -2.0, 0.3]])
    path = torch.tensor([[20.0, 0.0], [20.0, 20.0], [0.0, 20.0], [0.0, 0.0]], dtype=torch.float64)
    kept = guess_along(env, targets, [path], speed=1.0, intervals=160)
    assert kept.eta[0, 0].tolist() == [20.0, 0.0, -2.0, 0.3]
    torch.testing.assert_close(kept.eta[-1, 0, :3], targets.frame.target[0])
    assert bool((kept.eta[..., 3] == 0.3).all())
    # Half way along 60 m after 30 s.
    torch.testing.assert_close(kept.eta[60, 0, :3], torch.tensor([10.0, 20.0, -5.0], dtype=torch.float64))
    assert float(torch.linalg.vector_norm(kept.nu[60, 0, :2])) == pytest.approx(1.0)
    drag = env.vehicle.damping_matrix(kept.nu[60, 0]) @ kept.nu[60, 0]
    torch.testing.assert_close(kept.tau[60, 0], drag + env.vehicle.trim)
    # Its bow is nearer to east than to west, so it leaves the second leg backwards.
    turned = guess_along(env, targets, [path], speed=1.0, intervals=160, turn=True)
    assert turned.eta[20, 0, 3] == pytest.approx(math.pi / 2.0)
    assert abs(math.sin(turned.eta[60, 0, 3])) < 1e-9
    assert float(turned.nu[60, 0, 0].abs()) == pytest.approx(1.0)


def test_guess_from_a_flight():
    """Constant speed: linear in time, whatever the nodes."""
    time = torch.arange(41, dtype=torch.float64) * 0.05
    components = torch.zeros(41, 8, 2, 1, dtype=torch.float64)
    components[:, 0, 1, 0], components[:, 4, 1, 0] = 3.0 * time, 3.0
    tau = torch.arange(40, dtype=torch.float64)[:, None, None, None].expand(40, 2, 1, 4)
    guess = guess_from(Trajectory(components, tau, 0.05), world=1, intervals=16)
    torch.testing.assert_close(guess.eta[:, 0, 0], torch.linspace(0.0, 6.0, 17, dtype=torch.float64))
    assert bool((guess.nu[..., 0] == 3.0).all())
    assert guess.tau[:, 0, 0].tolist() == [*(int(2.5 * k) for k in range(16)), 39.0]
