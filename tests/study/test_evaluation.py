"""Missions: metrics of hand-made trajectories, and what flights are worth on the true channel."""

import math
from itertools import pairwise
from typing import NamedTuple

import pytest
import torch

from uwirl import build
from uwirl.motion.cost import CostWeights
from uwirl.snr.estimators import oracle
from uwirl.study.evaluation import Evaluation, Evaluator
from uwirl.world.agent import Agent, Feedback
from uwirl.world.readings import take_readings
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory, WorldState
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import VehicleState


def evaluation_of(capacity: list[float], optimum: float = 100.0, dt: float = 0.5) -> Evaluation:
    """A vehicle that moves 1 m a step along x with u = 2 m/s under tau_u = 3 N."""
    n = len(capacity) - 1
    components = torch.zeros(n + 1, 8, 1, 1, dtype=torch.float64)
    components[:, 0, 0, 0] = torch.arange(n + 1)
    components[:, 4] = 2.0
    tau = torch.zeros(n, 1, 1, 4, dtype=torch.float64)
    tau[..., 0] = 3.0
    links = torch.tensor(capacity, dtype=torch.float64)[:, None, None] + torch.tensor([0.0, 5.0], dtype=torch.float64)
    cost = {"link": torch.tensor([1.5]), "vehicle": torch.tensor([0.25]), "control": torch.tensor([0.5])}
    clearance = torch.full((n + 1, 1, 1), 0.5)
    clearance[1] = -0.25
    blocked = torch.zeros(1, 1, dtype=torch.bool)
    end = WorldState.of(VehicleState(components[-1]), n)
    saturated = torch.zeros(n, 1, 1, dtype=torch.bool)
    saturated[0] = True
    return Evaluation(Trajectory(components, tau, dt, 0, end), links, optimum, clearance, blocked, cost, saturated)


@pytest.mark.parametrize(
    ("capacity", "expected"),
    [
        ([10.0, 98.9, 99.0, 99.5], 1.0),
        ([10.0, 99.5, 50.0, 99.0], 1.5),  # it must stay
        ([99.0, 99.0], 0.0),
        ([10.0, 99.5, 98.0], None),
    ],
)
def test_time_to_99_percent(capacity, expected):
    assert evaluation_of(capacity).time_to_99_percent() == expected


def test_metrics():
    metrics = evaluation_of([20.0, 98.0, 99.0, 99.5, 99.5]).metrics()
    assert metrics["capacity_initial_mean_kbps"] == 20.0
    assert metrics["capacity_gain_percent"] == pytest.approx(100.0 * 99.5 / 20.0 - 100.0)
    assert metrics["link_capacity_final_kbps"] == [99.5, 104.5]
    assert metrics["path_length_m"] == 2.0  # to t99 = 1 s, two steps
    assert metrics["energy_J"] == pytest.approx(3.0 * 2.0 * 2.0)  # 6 W for 2 s
    assert metrics["cost_total"] == pytest.approx(2.25)
    assert metrics["collisions"] == 1
    assert metrics["min_obstacle_clearance_m"] == -0.25
    assert metrics["final_position_m"] == [[4.0, 0.0, 0.0]]
    assert metrics["saturated_share"] == 0.25
    assert metrics["guard_interventions"] is None


def resting(env: Relay) -> Agent:
    return Feedback(lambda observation: env.vehicle.trim.expand_as(observation.eta))


def test_cost_of_resting_is_the_running_cost_times_time(make_config, make_relay):
    """A vehicle held at its start by its trim: every term is a constant times 8 s."""
    env = make_relay("scenario.duration_s=8")
    evaluator = Evaluator(env, build.make_cost(make_config().cost))
    evaluation = evaluator.fly(resting(env))
    cost = evaluator.mission.cost
    xi = evaluator.mission.targets.frame.relative(env.start().vehicles)
    assert float(evaluation.cost_terms["link"][0]) == pytest.approx(8.0 * float(cost.link(xi)), rel=1e-9)
    assert float(evaluation.cost_terms["vehicle"][0]) == pytest.approx(8.0 * float(cost.yaw(xi)), rel=1e-9)
    assert float(evaluation.cost_terms["control"][0]) == 0.0


def test_worlds_are_evaluated_one_by_one(make_config, make_relay):
    config, env = make_config("scenario.duration_s=5"), make_relay("scenario.duration_s=5")
    evaluator = Evaluator(env, build.make_cost(config.cost))
    eta = 5.0 * torch.randn(4, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    agent = Feedback(lambda observation: -3.0 * observation.eta)
    together = evaluator.fly(agent, WorldState.of(VehicleState.from_eta_nu(eta))).cost
    alone = [evaluator.fly(agent, WorldState.of(VehicleState.from_eta_nu(e[None]))).cost for e in eta]
    torch.testing.assert_close(together, torch.cat(alone), rtol=1e-12, atol=0)


def test_missions_are_judged_by_the_truth(make_config, make_relay):
    """Not by what is believed: the same flight is worth what the links of the true channel carry."""
    cost = build.make_cost(make_config().cost)
    places = ([-30.0, -30.0, -8.0], [29.5, 29.5, 0.0], [30.0, 30.0, -8.0])
    lengths = [math.dist(*ends) for ends in pairwise(places)]
    for name in ("paper", "acoustic_24khz"):
        env = make_relay(f"channel={name}", "scenario.duration_s=1")
        evaluation = Evaluator(env, cost).fly(resting(env))
        channel = truth_of(env).channel
        *carried, best = channel.mean_capacity_kbps(
            torch.tensor([*lengths, 30.0 * 2**0.5], dtype=torch.float64)
        ).tolist()
        assert evaluation.link_capacity[-1, 0].tolist() == pytest.approx(carried, rel=1e-12)
        assert evaluation.optimal_capacity == pytest.approx(best, rel=1e-12)


def test_a_guard_stands_before_the_thrusters(make_relay):
    """It has the last word, and what it makes of the agent's tau is what counts as effort."""
    env = make_relay("scenario.duration_s=1")
    evaluator = Evaluator(env, CostWeights(), lambda tau, observation: 0.5 * tau)
    evaluation = evaluator.fly(Feedback(lambda observation: torch.full_like(observation.eta, 8.0)))
    assert torch.equal(evaluation.trajectory.tau, torch.full((20, 1, 1, 4), 4.0, dtype=torch.float64))
    other = evaluator.in_worlds(env.select(torch.tensor([0]))).fly(resting(env))
    assert torch.equal(other.trajectory.tau[0, 0, 0], 0.5 * env.vehicle.trim)


def test_interventions_of_the_guard_are_counted(make_relay):
    """Steps at which what reaches the thrusters is not what the agent wanted; their own limits are no intervention."""
    env = make_relay("experiment=fig6_pair", "scenario.duration_s=1")

    def guard(tau, observation):
        slack = torch.where(observation.step % 4 == 0, 2.0, 1e-9)[:, None, None]
        return torch.cat([tau[:, :1] + slack, tau[:, 1:]], 1)

    wanted = Feedback(lambda observation: torch.where(observation.step < 10, 1e4, 1.0)[:, None, None].expand(-1, 2, 4))
    flown = Evaluator(env, CostWeights(), guard).fly(Feedback(lambda seen: wanted.law(seen).to(seen.eta.dtype)))
    # Above the limits, 2 N more are none.
    steps = torch.arange(20)
    assert torch.equal(flown.intervened[:, 0, 0], (steps % 4 == 0) & (steps >= 10))
    assert not bool(flown.intervened[:, 0, 1].any())
    metrics = flown.metrics()
    assert (metrics["guard_interventions"], metrics["guard_intervention_share"]) == (2, 0.1)
    assert metrics["saturated_share"] == 0.5


def test_a_flight_may_be_judged_again(make_relay):
    """From its trajectory alone: also a flight that went on from another."""
    env = make_relay("scenario.duration_s=2")
    evaluator = Evaluator(env, CostWeights())
    agent = Feedback(lambda observation: -3.0 * observation.eta)
    whole = evaluator.judge(env.rollout(agent, steps=40))
    first = env.rollout(agent, steps=15)
    parts = [evaluator.judge(first), evaluator.judge(env.rollout(agent, first.end, 25, first.carry))]
    torch.testing.assert_close(parts[0].cost + parts[1].cost, whole.cost, rtol=1e-12, atol=0)
    torch.testing.assert_close(evaluator.fly(agent).cost, whole.cost, rtol=0, atol=0)


def test_blocked_is_what_the_agent_says(make_relay):
    """Of its carry at the end; an agent that plans no way is never blocked."""

    class Lost(NamedTuple):
        blocked: torch.Tensor

    class Wanderer:
        def init(self, observation):
            return Lost(torch.zeros(1, 1, dtype=torch.bool))

        def act(self, carry, observation):
            return torch.zeros_like(observation.eta), Lost(observation.step[:, None] >= 10)

    env = make_relay("scenario.duration_s=2")
    evaluator = Evaluator(env, CostWeights())
    assert evaluator.judge(env.rollout(Wanderer(), steps=10)).blocked.tolist() == [[False]]
    assert evaluator.fly(Wanderer()).blocked.tolist() == [[True]]
    assert evaluator.fly(resting(env)).metrics()["blocked"] == 0


def test_obstacle_term_of_a_resting_vehicle(make_config, make_relay):
    """beta_2 (1/l - 1/rho_o)^2 times 5 s, 3 m from an axis with an influence radius of 6 m."""
    cylinder = "scenario.obstacles=[{center_m:[29.5,26.5],radius_m:1,influence_m:6}]"
    overrides = ("scenario.duration_s=5", cylinder, "cost.beta_2=2")
    env = make_relay(*overrides)
    evaluation = Evaluator(env, build.make_cost(make_config(*overrides).cost)).fly(resting(env))
    assert float(evaluation.cost_terms["obstacle"][0]) == pytest.approx(2.0 * 5.0 * (1 / 3 - 1 / 6) ** 2, rel=1e-9)
    assert evaluation.metrics()["min_obstacle_clearance_m"] == pytest.approx(3.0 - 1.0 - 0.3)


def test_agents_side_by_side_fly_what_each_flies_alone(make_config, make_relay):
    """To the last bit, also with a guard, obstacles and drift, and with agents of different kinds."""
    overrides = ("experiment=fig5_single", "scenario.duration_s=3", "scenario.start=[[8,9,-12,1]]")
    config, env = make_config(*overrides), make_relay(*overrides)
    evaluator = build.make_evaluator(config, env)
    truth = oracle(take_readings(env), env.budget, truth_of(env).channel)
    guided = build.make_planner(config, config.baseline, env).fit(env, truth)
    agents = [(guided, 3), (resting(env), 1), (guided, 40)]
    flown = evaluator.fly_side_by_side(agents, [1] * 44)
    alone = evaluator.fly(guided)
    for evaluation in (*flown[:3], *flown[4:]):
        assert torch.equal(evaluation.trajectory.components, alone.trajectory.components)
        assert torch.equal(evaluation.cost, alone.cost)
        assert torch.equal(evaluation.blocked, alone.blocked)
    assert torch.equal(flown[3].trajectory.components, evaluator.fly(resting(env)).trajectory.components)
