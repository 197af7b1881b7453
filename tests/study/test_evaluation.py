"""Mission metrics against hand-made trajectories."""

import pytest
import torch

from uwirl import build
from uwirl.motion.targets import mean_channel_targets
from uwirl.study.evaluation import Evaluation, evaluate
from uwirl.world.trajectory import Trajectory
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
    return Evaluation(Trajectory(components, tau, dt), links, optimum, clearance, blocked, cost)


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


def test_cost_of_resting_is_the_running_cost_times_time(make_config, make_relay):
    """A vehicle held at its start by its trim: every term is a constant times 80 s."""
    config, env = make_config(), make_relay()
    targets = mean_channel_targets(env.scenario, env.channel)
    cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
    evaluation = evaluate(env, lambda state, step: env.vehicle.trim.expand(1, 1, 4), cost, targets, env.reset())
    xi = targets.frame.relative(env.reset())
    assert float(evaluation.cost_terms["link"][0]) == pytest.approx(80.0 * float(cost.link(xi)), rel=1e-9)
    assert float(evaluation.cost_terms["vehicle"][0]) == pytest.approx(80.0 * float(cost.yaw(xi)), rel=1e-9)
    assert float(evaluation.cost_terms["control"][0]) == 0.0


def test_worlds_are_evaluated_one_by_one(make_config, make_relay):
    config, env = make_config("scenario.duration_s=5"), make_relay("scenario.duration_s=5")
    targets = mean_channel_targets(env.scenario, env.channel)
    cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
    eta = 5.0 * torch.randn(4, 1, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def policy(state, step):
        return -3.0 * state.eta

    together = evaluate(env, policy, cost, targets, VehicleState.from_eta_nu(eta)).cost
    alone = torch.cat([evaluate(env, policy, cost, targets, VehicleState.from_eta_nu(e[None])).cost for e in eta])
    torch.testing.assert_close(together, alone, rtol=1e-12, atol=0)


def test_obstacle_term_of_a_resting_vehicle(make_config, make_relay):
    """beta_2 (1/l - 1/rho_o)^2 times 5 s, 3 m from an axis with an influence radius of 6 m."""
    cylinder = "scenario.obstacles=[{center_m:[29.5,26.5],radius_m:1,influence_m:6}]"
    overrides = ("scenario.duration_s=5", cylinder, "cost.beta_2=2")
    config, env = make_config(*overrides), make_relay(*overrides)
    targets = mean_channel_targets(env.scenario, env.channel)
    cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
    evaluation = evaluate(env, lambda state, step: env.vehicle.trim.expand(1, 1, 4), cost, targets, env.reset())
    assert float(evaluation.cost_terms["obstacle"][0]) == pytest.approx(2.0 * 5.0 * (1 / 3 - 1 / 6) ** 2, rel=1e-9)
    assert evaluation.metrics()["min_obstacle_clearance_m"] == pytest.approx(3.0 - 1.0 - 0.3)
