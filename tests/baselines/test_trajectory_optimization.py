"""The trajectory optimiser against reference costs, the world's own model of vehicle and cost, and its constraints."""

import math
import sys
from dataclasses import replace

import pytest
import torch

from uwirl import build
from uwirl.baselines.guesses import guess_along, guess_from
from uwirl.baselines.trajectory_optimization import PlanAgent, TrajectoryOptimization, optimise
from uwirl.motion.mission import Mission
from uwirl.snr.estimators import oracle
from uwirl.study.evaluation import Evaluator
from uwirl.world.integration import derivative
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams
from uwirl.world.readings import take_readings
from uwirl.world.trajectory import Trajectory, WorldState
from uwirl.world.truth import truth_of
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
def mission_from(make_config, make_relay):
    """mission_from(start, overrides...): on the true channel; a world for each of starts [B, M, 4]."""

    def make(start=PAPER, *overrides: str, **changes) -> Mission:
        overrides = overrides or ("experiment=fig5_free",)
        config, env = make_config(*overrides), make_relay(*overrides)
        start = torch.tensor(start, dtype=env.scenario.start.dtype)
        worlds = RandomStreams.worlds(0, len(start) if start.ndim == 3 else 1)
        env = env.on(replace(env.scenario, start=start, **changes), worlds)
        return Mission(env, truth_of(env).channel, build.make_cost(config.cost))

    return make


def flown(mission: Mission, agent):
    return Evaluator(mission.env, mission.weights).fly(agent)


@pytest.fixture
def solver():
    return pytest.importorskip("casadi")


def straight(mission: Mission, intervals: int = 200, turns=(False, True), world: int = 0):
    env, targets = mission.env, mission.targets
    start = env.scenario.start.view(-1, env.scenario.vehicles, 4)[world]
    paths = [torch.stack([p, q]) for p, q in zip(start[:, :2], targets.frame.target[:, :2], strict=True)]
    return [guess_along(env, targets, paths, 0.8, intervals, turn, world, f"straight, turn={turn}") for turn in turns]


def round_the_obstacles(mission: Mission, intervals: int = 200):
    """Between the two obstacles of Fig. 5 and the axis y = x on its upper side."""
    path = torch.tensor([[29.5, 29.5], [18.4, 22.6], [6.9, 13.1], [0.0, 0.0]], dtype=torch.float64)
    return guess_along(mission.env, mission.targets, [path], 0.8, intervals, name="round")


def check_reference(mission, printed):
    plan = optimise(mission, straight(mission))
    assert all(attempt.converged for attempt in plan.attempts)
    # Printed to three decimals.
    assert plan.cost == pytest.approx(printed, rel=0.01, abs=5e-4)


@pytest.mark.parametrize(("start", "printed"), [REFERENCES[k] for k in (1, 9, 12)])
def test_reference_costs(solver, mission_from, start, printed):
    check_reference(mission_from([start]), printed)


@pytest.mark.slow
@pytest.mark.parametrize(("start", "printed"), REFERENCES)
def test_all_reference_costs(solver, mission_from, start, printed):
    check_reference(mission_from([start]), printed)


@pytest.mark.parametrize("cost_name", ["relay", "paper"])
def test_plan_obeys_the_world(solver, mission_from, cost_name):
    """Defects by the right-hand side of (1) and J by RelayCost, both at the nodes."""
    mission = mission_from(PAPER, "experiment=fig5_single", f"cost={cost_name}")
    env, cost = mission.env, mission.cost
    plan = optimise(mission, [round_the_obstacles(mission)])
    assert plan.converged
    assert bool((plan.tau.abs() <= env.vehicle.tau_max + 1e-5).all())
    assert -env.scenario.depth <= float(plan.eta[..., 2].min()) <= float(plan.eta[..., 2].max()) <= 1e-6
    torch.testing.assert_close(plan.eta[0], env.scenario.start)
    assert not bool(plan.nu[0].any())

    h = env.scenario.duration / 200
    force = (plan.tau - env.vehicle.restoring).movedim(-1, 0)
    rows = VehicleState.from_eta_nu(plan.eta, plan.nu).components
    f = derivative(env.vehicle.body(rows), rows[3:], force).movedim(0, -1)
    x = torch.cat([plan.eta, plan.nu], -1)
    defect = x.diff(dim=0) - h / 2.0 * (f[1:] + f[:-1])
    assert float(defect.abs().max()) < 5e-3  # |nu| is rounded near rest

    state = VehicleState.from_eta_nu(plan.eta, plan.nu)
    time = h * torch.arange(201)
    q = cost.state(mission.targets.frame.relative(state)) + cost.control(plan.tau - env.vehicle.trim)
    q = q + cost.obstacle(env.scenario.obstacles, state.position, time)
    assert plan.cost == pytest.approx(float(torch.trapezoid(q, dx=h, dim=0).sum()), rel=1e-4)


def test_agent_flies_its_plan(solver, mission_from):
    """At full thrust the Munk moment turns a vehicle that yaws softly off its plan: J is then half as much again."""
    mission = mission_from()
    env, plan = mission.env, optimise(mission, straight(mission))
    agent = PlanAgent(env, plan)
    evaluation = flown(mission, agent)
    assert float(evaluation.cost[0]) == pytest.approx(plan.cost, rel=0.02)
    off = evaluation.trajectory.eta[::8, 0] - plan.eta
    assert float(torch.linalg.vector_norm(off[..., :3], dim=-1).max()) < 0.2
    assert evaluation.metrics()["capacity_final_mean_kbps"] == pytest.approx(62.045, abs=0.01)

    def tau(eta: torch.Tensor, step: int = 0) -> torch.Tensor:
        state = WorldState.of(VehicleState.from_eta_nu(eta), step)
        return agent.act((), env.observe(state))[0]

    start = env.scenario.start[None]
    assert tau(start.expand(3, 1, 4)).shape == (3, 1, 4)
    turned = start + torch.tensor([0.0, 0.0, 0.0, 2.0 * math.pi], dtype=torch.float64)
    torch.testing.assert_close(tau(turned), tau(start))
    torch.testing.assert_close(tau(plan.eta[-1:], 10**6), env.vehicle.trim.expand(1, 1, 4))


def test_planner_plans_along_the_map_and_plays_the_plan(solver, mission_from):
    mission = mission_from()
    truth = oracle(take_readings(mission.env), mission.env.budget, mission.channel)
    planner = TrajectoryOptimization(mission.weights, intervals=50)
    plan = planner.plan(mission.env, truth)
    assert [attempt.name for attempt in plan.attempts] == ["map, 0.8 m/s", "map, 0.8 m/s, turned"]
    played, expected = (agent.tau for agent in (planner.fit(mission.env, truth), PlanAgent(mission.env, plan)))
    torch.testing.assert_close(played, expected)


def test_fig5_goes_round_the_obstacles(solver, mission_from):
    mission = mission_from(PAPER, "experiment=fig5_single")
    guesses = [*straight(mission, turns=(False,)), round_the_obstacles(mission)]
    plan = optimise(mission, guesses)
    assert plan.guess == "round"
    assert [attempt.name for attempt in plan.attempts] == [guess.name for guess in guesses]
    assert plan.cost == min(attempt.cost for attempt in plan.attempts)
    assert 3.147 < plan.cost <= 3.30
    assert float(mission.env.scenario.clearance(plan.eta[..., :3]).min()) >= -1e-4
    evaluation = flown(mission, PlanAgent(mission.env, plan))
    assert float(evaluation.cost[0]) == pytest.approx(plan.cost, rel=0.02)
    assert float(evaluation.clearance.min()) > 0.0


def test_drifting_and_absent_obstacles_of_one_world_of_a_batch(solver, mission_from):
    """World 0: a cylinder that drifts into the way. World 1: none."""
    start = [20.0, 0.0, -8.0, math.pi / 4.0]
    centre = torch.tensor([10.0, -10.0], dtype=torch.float64).expand(2, 1, 2)
    radius = torch.full((2, 1), 2.0, dtype=torch.float64)
    velocity = torch.tensor([0.0, 0.4], dtype=torch.float64).expand(2, 1, 2)
    obstacles = Obstacles(centre, radius, 3.0 * radius, velocity, torch.tensor([[True], [False]]))
    mission = mission_from([[start], [start]], obstacles=obstacles, duration=40.0)
    mission = replace(mission, weights=replace(mission.weights, beta_2=0.0))
    plans = [optimise(mission, straight(mission, 100, (False,), b), 100, b, max_iterations=500) for b in (0, 1)]
    assert all(plan.converged for plan in plans)
    time = torch.linspace(0.0, 40.0, 101, dtype=torch.float64)
    gap = mission.env.scenario.clearance(torch.stack([plan.eta for plan in plans], 1)[..., :3], time[:, None])
    assert float(gap[:, 0].min()) == pytest.approx(0.0, abs=1e-3)
    assert plans[1].cost < plans[0].cost
    free = mission_from([start], duration=40.0)
    alone = optimise(free, straight(free, 100, (False,)), 100)
    assert plans[1].cost == pytest.approx(alone.cost, rel=1e-6)


def test_vehicles_that_swap_keep_apart(solver, mission_from):
    """Head-on, each is to go where the other starts; at 2.6 m/s they meet between two nodes."""
    mission = mission_from([[12.0, 12.0, -8.0, 0.8], [-12.0, -12.0, -8.0, 0.8]], duration=40.0)
    plan = optimise(mission, straight(mission, 50, (False,)), 50)
    assert plan.converged

    def separation(eta):
        return float(torch.linalg.vector_norm(eta[..., 0, :3] - eta[..., 1, :3], dim=-1).min())

    assert separation(plan.eta) >= 1.0 - 1e-4
    evaluation = flown(mission, PlanAgent(mission.env, plan))
    assert separation(evaluation.trajectory.eta) >= 0.95
    assert float(evaluation.cost[0]) == pytest.approx(plan.cost, rel=0.02)


def test_failure_is_reported(solver, mission_from):
    mission = mission_from()
    plan = optimise(mission, straight(mission, 50), 50, max_iterations=1)
    assert not plan.converged
    assert [attempt.converged for attempt in plan.attempts] == [False, False]
    best = min(plan.attempts, key=lambda attempt: attempt.infeasibility)
    assert best.infeasibility > 1e-4
    assert (plan.guess, plan.cost) == (best.name, best.cost)


def test_missing_solver_is_named(monkeypatch, mission_from):
    monkeypatch.setitem(sys.modules, "casadi", None)
    mission = mission_from()
    with pytest.raises(ImportError, match=r"pip install 'uwirl\[solvers\]'"):
        optimise(mission, straight(mission))


def test_bad_guesses(solver, mission_from):
    mission = mission_from()
    with pytest.raises(ValueError, match="at least one"):
        optimise(mission, [])
    with pytest.raises(ValueError, match=r"straight, turn=False is not \[101, 1, 4\]"):
        optimise(mission, straight(mission, 50), 100)


def test_guess_along_a_path(mission_from):
    mission = mission_from([[20.0, 0.0, -2.0, 0.3]])
    env, targets = mission.env, mission.targets
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
    end = WorldState.of(VehicleState(components[-1]), 40)
    guess = guess_from(Trajectory(components, tau, 0.05, 0, end), world=1, intervals=16)
    torch.testing.assert_close(guess.eta[:, 0, 0], torch.linspace(0.0, 6.0, 17, dtype=torch.float64))
    assert bool((guess.nu[..., 0] == 3.0).all())
    assert guess.tau[:, 0, 0].tolist() == [*(int(2.5 * k) for k in range(16)), 39.0]
