"""Running cost and targets against the channel's closed forms and brute force."""

import math
from dataclasses import replace

import pytest
import torch

from uwirl.motion.targets import NoTargetError, mean_channel_targets
from uwirl.world.truth import truth_of


def at(*pose: float) -> torch.Tensor:
    xi = torch.zeros(1, 8, dtype=torch.float64)
    xi[0, : len(pose)] = torch.tensor(pose)
    return xi


def test_cost_vanishes_at_rest_at_the_target(make_mission):
    cost = make_mission().cost
    assert float(cost.state(at())) == pytest.approx(0.0, abs=1e-15)
    assert float(cost.control(torch.zeros(1, 4, dtype=torch.float64))) == 0.0


def test_cost_of_the_papers_start(make_mission):
    """100 / C^2 less its minimum, with the paper's two capacities; the bearing is 45 degrees, psi = 1."""
    mission = make_mission()
    cost, xi = mission.cost, mission.targets.frame.relative(mission.env.start().vehicles)[0]
    link = 100.0 / 17.302140**2 - 100.0 / 62.045244**2
    assert float(cost.link(xi)) == pytest.approx(link, rel=1e-6)
    assert float(cost.yaw(xi)) == pytest.approx(0.01 * (1.0 - math.cos(1.0 - math.pi / 4)), rel=1e-9)


def test_full_thrust_costs_the_sum_of_R(make_mission):
    mission = make_mission()
    assert float(mission.cost.control(mission.env.vehicle.tau_max)) == pytest.approx(0.1 + 0.08 + 1.0 + 1.2)


@pytest.mark.parametrize(
    "overrides",
    [(), ("channel=acoustic_24khz",), ("scenario.source_m=[0,0,-5]", "scenario.destination_m=[20,-10,-12]")],
)
def test_target_is_where_a_search_finds_the_best_capacity(make_mission, overrides):
    mission = make_mission(*overrides)
    truth, scenario, cost = truth_of(mission.env), mission.env.scenario, mission.cost
    best = float(truth.link_capacities_kbps(mission.targets.frame.target).amin())
    middle = (scenario.source + scenario.destination) / 2.0
    offsets = 3.0 * torch.randn(20_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = truth.link_capacities_kbps((middle + offsets)[:, None]).amin(-1)
    assert float(found.max()) <= best
    assert float(cost.link(torch.cat([offsets, torch.zeros(20_000, 5)], -1)[:, None]).min()) >= 0.0


def test_cost_in_the_link_frame_is_the_cost_in_the_world(make_mission):
    mission = make_mission("scenario.source_m=[-5,10,-3]", "scenario.destination_m=[25,-10,-14]")
    truth, frame, state = truth_of(mission.env), mission.targets.frame, mission.env.start().vehicles
    capacity = truth.link_capacities_kbps(state.position).amin()
    optimum = truth.link_capacities_kbps(frame.target).amin()
    expected = 100.0 / capacity**2 - 100.0 / optimum**2
    torch.testing.assert_close(mission.cost.link(frame.relative(state))[0, 0], expected, rtol=1e-12, atol=0)


def test_chain_of_three_has_equal_hops(make_mission):
    mission = make_mission("scenario.start=[[1,2,-3,0],[4,5,-6,0],[7,8,-9,0]]")
    hops = torch.linalg.vector_norm(truth_of(mission.env).chain(mission.targets.frame.target).diff(dim=-2), dim=-1)
    torch.testing.assert_close(hops, hops.mean().expand(4), rtol=1e-12, atol=0)


def test_capacity_of_the_papers_pair(make_mission):
    """91.12 kbit/s over thirds of the link."""
    mission = make_mission("scenario.start=[[29.5,29.5,0,1],[30.5,28.5,0,2]]")
    links = truth_of(mission.env).link_capacities_kbps(mission.targets.frame.target)
    assert float(links.amin()) == pytest.approx(91.122, abs=1e-3)


def test_an_estimate_that_grows_with_distance_has_no_target(make_relay):
    env = make_relay()
    with pytest.raises(NoTargetError, match="does not fall with distance"):
        mean_channel_targets(env.scenario, replace(truth_of(env).channel, n=-1.0))
