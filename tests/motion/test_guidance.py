"""Routes round obstacles, and missions led along them."""

import math
from functools import cache

import pytest
import torch

from uwirl import build
from uwirl.motion.route import MapSettings, Router
from uwirl.snr.estimators import oracle
from uwirl.world.readings import take_readings
from uwirl.world.truth import truth_of


def cup(radius: float = 5.0, cylinders: int = 9) -> str:
    """A dead end between the start (20, 20) and the target (0, 0), open towards the start, a little askew.

    With a dead end in line, both ways round would cost the same, and the descent would follow the ridge between them.
    """
    angles = [math.radians(237.0 + 200.0 * (k / (cylinders - 1) - 0.5)) for k in range(cylinders)]
    places = [(10.0 + radius * math.cos(a), 10.0 + radius * math.sin(a)) for a in angles]
    return ",".join(f"{{center_m:[{x:.3f},{y:.3f}],radius_m:1.2,influence_m:5}}" for x, y in places)


PAPERS = ("experiment=fig5_single", "scenario.duration_s=60")
DEAD_END = (f"scenario.obstacles=[{cup()}]", "scenario.start=[[20,20,-4,0]]", "scenario.duration_s=60")


@pytest.fixture(scope="module")
def fly(make_config, make_relay):
    """A PD mission behind the guard, flown once however many ask for it."""

    @cache
    def go(*overrides: str):
        overrides = ("planner=pd", *overrides)
        config, env = make_config(*overrides), make_relay(*overrides)
        truth = oracle(take_readings(env), env.budget, truth_of(env).channel)
        agent = build.make_planner(config, config.planner, env).fit(env, truth)
        return build.make_evaluator(config, env).fly(agent)

    return go


def test_free_water_leads_straight(make_config, make_mission):
    overrides = ("experiment=fig5_free",)
    controller = object()
    assert build.make_guidance(make_config(*overrides))(make_mission(*overrides))(controller) is controller


def ways(mission, start=None):
    """The plan of all vehicles of one world from the scenario's start, or another."""
    scenario = mission.env.scenario
    router = Router(scenario, mission.targets.frame, mission.cost, 0.1, MapSettings(spacing_m=0.5))
    start = scenario.start if start is None else start
    obstacles = scenario.obstacles.each(lambda field: field.expand(len(start), *field.shape))
    return router.plan(torch.arange(len(start)), start[:, :2], obstacles, torch.zeros(len(start)))


@pytest.mark.parametrize("overrides", [("experiment=fig5_single",), DEAD_END])
def test_way_keeps_clear_and_arrives(make_mission, overrides):
    mission = make_mission(*overrides)
    scenario, plan = mission.env.scenario, ways(mission)
    path = plan.map.path(scenario.start[None, :, :2])[0, 0]
    assert float(scenario.clearance(path[:, None]).min()) > 0.25
    torch.testing.assert_close(path[-1], mission.targets.frame.target[0, :2], rtol=0, atol=1e-2)
    assert not bool(plan.blocked.any())


def test_mission_goes_round_the_papers_obstacles(fly):
    evaluation = fly(*PAPERS)
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


def test_goal_leaves_an_influence_that_reaches_the_target(make_mission):
    """An obstacle beside the target: resting there would cost E_O for ever."""
    mission = make_mission("scenario.obstacles=[{center_m:[1.5,1.5],radius_m:1,influence_m:5}]")
    plan, target = ways(mission), mission.targets.frame.target
    assert 0.3 < float(torch.linalg.vector_norm(plan.goal - target)) < 5.0
    at_target = mission.cost.obstacle(mission.env.scenario.obstacles, target)
    assert 0.0 < float(plan.rest_cost) < 0.8 * float(at_target)


def test_batch_of_worlds_equals_its_singles(make_mission):
    """Other starts in other worlds: the ways are those of each alone."""
    mission = make_mission("experiment=fig5_single")
    starts = torch.tensor([[29.5, 29.5, 0, 1], [-20.0, 5.0, 0, 0], [8.0, 20.0, 0, 0]], dtype=torch.float64)
    together = ways(mission, starts)
    for k, start in enumerate(starts):
        alone = ways(mission, start[None])
        torch.testing.assert_close(together.map.value[k], alone.map.value[0], rtol=0, atol=0)


def test_obstacles_are_found_on_the_way(fly):
    known, found = fly(*PAPERS), fly(*PAPERS, "scenario.detection_range_m=8")
    assert found.metrics()["collisions"] == 0
    assert found.time_to_99_percent() is not None
    assert float(known.cost) < float(found.cost) < 1.1 * float(known.cost)


def test_drifting_obstacle_is_let_pass(fly):
    crossing = "scenario.obstacles=[{center_m:[10,22],radius_m:2,influence_m:6,velocity_mps:[0.1,-0.4]}]"
    evaluation = fly(crossing, "guidance.spacing_m=1", "scenario.duration_s=60")
    assert evaluation.metrics()["collisions"] == 0
    assert evaluation.time_to_99_percent() is not None
