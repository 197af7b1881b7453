"""Running cost and targets against the channel's closed forms and brute force."""

import math
from dataclasses import replace

import pytest
import torch

from uwirl import build
from uwirl.motion.targets import NoTargetError, mean_channel_targets


@pytest.fixture
def problem(make_config, make_relay):
    """Environment, targets and true cost of a composed configuration."""

    def make(*overrides: str):
        config, env = make_config(*overrides), make_relay(*overrides)
        targets = mean_channel_targets(env.scenario, env.channel)
        return env, targets, build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)

    return make


def at(*pose: float) -> torch.Tensor:
    xi = torch.zeros(1, 8, dtype=torch.float64)
    xi[0, : len(pose)] = torch.tensor(pose)
    return xi


def test_cost_vanishes_at_rest_at_the_target(problem):
    _, _, cost = problem()
    assert float(cost.state(at())) == pytest.approx(0.0, abs=1e-15)
    assert float(cost.control(torch.zeros(1, 4, dtype=torch.float64))) == 0.0


def test_cost_of_the_papers_start(problem):
    """100 / C^2 less its minimum, with the paper's two capacities; the bearing is 45 degrees, psi = 1."""
    env, targets, cost = problem()
    xi = targets.frame.relative(env.reset())[0]
    link = 100.0 / 17.302140**2 - 100.0 / 62.045244**2
    assert float(cost.link(xi)) == pytest.approx(link, rel=1e-6)
    assert float(cost.yaw(xi)) == pytest.approx(0.01 * (1.0 - math.cos(1.0 - math.pi / 4)), rel=1e-9)


def test_full_thrust_costs_the_sum_of_R(problem):
    env, _, cost = problem()
    assert float(cost.control(env.vehicle.tau_max)) == pytest.approx(0.1 + 0.08 + 1.0 + 1.2)


@pytest.mark.parametrize(
    "overrides",
    [(), ("channel=acoustic_24khz",), ("scenario.source_m=[0,0,-5]", "scenario.destination_m=[20,-10,-12]")],
)
def test_target_is_where_a_search_finds_the_best_capacity(problem, overrides):
    env, targets, cost = problem(*overrides)
    best = float(env.link_capacities_kbps(targets.frame.target).amin())
    middle = (env.scenario.source + env.scenario.destination) / 2.0
    offsets = 3.0 * torch.randn(20_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = env.link_capacities_kbps((middle + offsets)[:, None]).amin(-1)
    assert float(found.max()) <= best
    assert float(cost.link(torch.cat([offsets, torch.zeros(20_000, 5)], -1)[:, None]).min()) >= 0.0


def test_cost_in_the_link_frame_is_the_cost_in_the_world(problem):
    env, targets, cost = problem("scenario.source_m=[-5,10,-3]", "scenario.destination_m=[25,-10,-14]")
    state = env.reset()
    capacity = env.link_capacities_kbps(state.position).amin()
    optimum = env.link_capacities_kbps(targets.frame.target).amin()
    expected = 100.0 / capacity**2 - 100.0 / optimum**2
    torch.testing.assert_close(cost.link(targets.frame.relative(state))[0, 0], expected, rtol=1e-12, atol=0)


def test_chain_of_three_has_equal_hops(make_relay):
    env = make_relay("scenario.start=[[1,2,-3,0],[4,5,-6,0],[7,8,-9,0]]")
    targets = mean_channel_targets(env.scenario, env.channel)
    hops = torch.linalg.vector_norm(env.chain(targets.frame.target).diff(dim=-2), dim=-1)
    torch.testing.assert_close(hops, hops.mean().expand(4), rtol=1e-12, atol=0)


def test_capacity_of_the_papers_pair(make_relay):
    """91.12 kbit/s over thirds of the link."""
    env = make_relay("scenario.start=[[29.5,29.5,0,1],[30.5,28.5,0,2]]")
    targets = mean_channel_targets(env.scenario, env.channel)
    assert float(env.link_capacities_kbps(targets.frame.target).amin()) == pytest.approx(91.122, abs=1e-3)


def test_an_estimate_that_grows_with_distance_has_no_target(make_relay):
    env = make_relay()
    with pytest.raises(NoTargetError, match="does not fall with distance"):
        mean_channel_targets(env.scenario, replace(env.channel, n=-1.0))
