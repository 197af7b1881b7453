"""Routes round obstacles, and missions led along them."""

import math

import pytest
import torch

from uwirl import build
from uwirl.motion.route import MapSettings, Router
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import oracle
from uwirl.study.evaluation import evaluate
from uwirl.world.messages import take_readings


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
        return evaluate(env, policy, cost, targets, env.reset(), build.make_guard(config))

    return go


def test_free_water_leads_straight(world):
    config, env, _, targets, cost = world("experiment=fig5_free")
    policy = object()
    assert build.make_guidance(config)(env, cost, targets)(policy) is policy


def ways(env, targets, cost, start=None):
    """The plan of all vehicles of one world from the scenario's start, or another."""
    router = Router(env.scenario, targets.frame, cost, 0.1, MapSettings(spacing_m=0.5))
    start = env.scenario.start if start is None else start
    obstacles = env.scenario.obstacles.each(lambda field: field.expand(len(start), *field.shape))
    return router.plan(torch.arange(len(start)), start[:, :2], obstacles, 0.0)


@pytest.mark.parametrize("overrides", [("experiment=fig5_single",), DEAD_END])
def test_way_keeps_clear_and_arrives(world, overrides):
    _, env, _, targets, cost = world(*overrides)
    plan = ways(env, targets, cost)
    path = plan.map.path(env.scenario.start[None, :, :2])[0, 0]
    assert float(env.scenario.clearance(path[:, None]).min()) > 0.25
    torch.testing.assert_close(path[-1], targets.frame.target[0, :2], rtol=0, atol=1e-2)
    assert not bool(plan.blocked.any())


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


RING = "scenario.obstacles=[{}]".format(
    ",".join(
        f"{{center_m:[{6.0 * math.cos(a):.3f},{6.0 * math.sin(a):.3f}],radius_m:1.0,influence_m:5}}"
        for a in (2.0 * math.pi * k / 24 for k in range(24))
    )
)


def test_a_ring_around_the_target_is_blocked_and_approached_but_not_touched(fly):
    evaluation = fly(RING)
    assert evaluation.blocked.tolist() == [[True]]
    metrics = evaluation.metrics()
    assert metrics["blocked"] == 1
    assert metrics["collisions"] == 0
    assert metrics["time_to_99_percent_s"] is None
    assert evaluation.trajectory.nu[-1].abs().max() < 0.05
    # No place outside the ring is nearer than 7 m; its influence makes a little more the best.
    assert 7.3 < float(torch.linalg.vector_norm(evaluation.trajectory.eta[-1, 0, 0, :2])) < 12.0


def test_goal_leaves_an_influence_that_reaches_the_target(world):
    """An obstacle beside the target: resting there would cost E_O for ever."""
    _, env, _, targets, cost = world("scenario.obstacles=[{center_m:[1.5,1.5],radius_m:1,influence_m:5}]")
    plan = ways(env, targets, cost)
    target = targets.frame.target
    assert 0.3 < float(torch.linalg.vector_norm(plan.goal - target)) < 5.0
    at_target = cost.obstacle(env.scenario.obstacles, target)
    assert 0.0 < float(plan.rest_cost) < 0.8 * float(at_target)


def test_batch_of_worlds_equals_its_singles(world):
    """Other starts in other worlds: the ways are those of each alone."""
    _, env, _, targets, cost = world("experiment=fig5_single")
    starts = torch.tensor([[29.5, 29.5, 0, 1], [-20.0, 5.0, 0, 0], [8.0, 20.0, 0, 0]], dtype=torch.float64)
    together = ways(env, targets, cost, starts)
    for k, start in enumerate(starts):
        alone = ways(env, targets, cost, start[None])
        torch.testing.assert_close(together.map.value[k], alone.map.value[0], rtol=0, atol=0)


def test_obstacles_are_found_on_the_way(fly):
    known, found = fly("experiment=fig5_single"), fly("experiment=fig5_single", "scenario.detection_range_m=8")
    assert found.metrics()["collisions"] == 0
    assert found.time_to_99_percent() is not None
    assert float(known.cost) < float(found.cost) < 1.1 * float(known.cost)


def test_drifting_obstacle_is_let_pass(fly):
    crossing = "scenario.obstacles=[{center_m:[10,22],radius_m:2,influence_m:6,velocity_mps:[0.1,-0.4]}]"
    evaluation = fly(crossing, "guidance.spacing_m=1")
    assert evaluation.metrics()["collisions"] == 0
    assert evaluation.time_to_99_percent() is not None
