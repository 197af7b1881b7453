"""Routes round obstacles, and missions led along them."""

import math

import pytest
import torch

from uwirl import build
from uwirl.motion.route import HARD_CLEARANCE, place_cost, route_map
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.snr.measurements import take_readings
from uwirl.study.evaluation import evaluate


def cup(radius: float = 5.0, cylinders: int = 9) -> str:
    """A dead end between the start (20, 20) and the target (0, 0), open towards the start, a little askew.

    With a dead end in line, both ways round would cost the same, and the descent would follow the ridge between them.
    """
    angles = [math.radians(237.0 + 200.0 * (k / (cylinders - 1) - 0.5)) for k in range(cylinders)]
    places = [(10.0 + radius * math.cos(a), 10.0 + radius * math.sin(a)) for a in angles]
    return ",".join(f"{{center_m:[{x:.3f},{y:.3f}],radius_m:1.2,influence_m:5}}" for x, y in places)


DEAD_END = (f"scenario.obstacles=[{cup()}]", "scenario.start=[[20,20,-4,0]]", "scenario.duration_s=120")


@pytest.fixture
def world(make_config, make_relay):
    def make(*overrides: str):
        config, env = make_config(*overrides), make_relay(*overrides)
        truth = oracle(take_readings(env), env.channel)
        targets = mean_channel_targets(env.scenario, env.channel)
        cost = build.make_cost(config.cost, env.channel, targets, env.vehicle.tau_max)
        return config, env, truth, targets, cost

    return make


@pytest.fixture
def fly(world):
    """A PD mission behind the guard."""

    def go(*overrides: str):
        config, env, truth, targets, cost = world("planner=pd", *overrides)
        policy = build.make_planner(config, config.planner, env).fit(env, truth)
        return evaluate(env, build.make_guard(config)(env, policy), cost, targets, env.reset())

    return go


def test_free_water_leads_straight(world):
    config, env, _, targets, cost = world()
    policy = object()
    assert build.make_guidance(config)(env, cost, targets)(policy) is policy


def test_place_cost_is_the_running_cost_of_being_there(world):
    _, env, _, targets, cost = world("experiment=fig5_single")
    state = env.reset()
    expected = cost.link(targets.frame.relative(state)) + env.scenario.obstacles.avoidance(state.position)
    torch.testing.assert_close(place_cost(env.scenario, targets.frame, cost, state.position), expected)


@pytest.mark.parametrize("overrides", [("experiment=fig5_single",), DEAD_END])
def test_route_keeps_clear_and_arrives(world, overrides):
    _, env, _, targets, cost = world(*overrides)
    route = route_map(env.scenario, targets.frame, cost, spacing_m=0.5)
    path = route.path(env.scenario.start[None, :, :2])[0, 0]
    position = torch.cat([path, torch.zeros(len(path), 1)], -1)[:, None]
    assert float(env.scenario.clearance(position).min()) > HARD_CLEARANCE
    torch.testing.assert_close(path[-1], targets.frame.target[0, :2], rtol=0, atol=1e-2)


def test_mission_goes_round_the_papers_obstacles(fly):
    evaluation = fly("experiment=fig5_single")
    metrics = evaluation.metrics()
    assert metrics["collisions"] == 0
    assert metrics["min_obstacle_clearance_m"] > 0.5
    assert metrics["time_to_99_percent_s"] < 43.0


def test_dead_end_is_left_with_the_map_and_not_without(fly):
    with_map, without = fly(*DEAD_END), fly(*DEAD_END, "guidance=straight")
    assert with_map.metrics()["collisions"] == without.metrics()["collisions"] == 0
    assert with_map.time_to_99_percent() is not None
    assert without.time_to_99_percent() is None
