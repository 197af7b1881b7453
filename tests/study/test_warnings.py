"""What is said of missions, learning and campaigns that went wrong, and nothing of those that went well."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace

import pytest
import torch

from uwirl.study.campaign import Outcomes
from uwirl.study.evaluation import Evaluation
from uwirl.study.mission_table import table
from uwirl.study.warnings import campaign_warnings, flight_warnings, learning_warnings, mission_warnings
from uwirl.world.obstacles import Obstacles
from uwirl.world.scenario import Scenario
from uwirl.world.trajectory import Trajectory, WorldState
from uwirl.world.vehicle import VehicleState

DT, STEPS = 0.5, 4
CYLINDERS = Obstacles(
    torch.tensor([[50.0, 0.0], [3.0, 0.0]], dtype=torch.float64),
    torch.tensor([1.0, 1.0], dtype=torch.float64),
    torch.tensor([2.0, 2.0], dtype=torch.float64),
    torch.zeros(2, 2, dtype=torch.float64),
    torch.ones(2, dtype=torch.bool),
)


def mission(y: tuple[float, float] = (10.0, 20.0), final: float = 100.0) -> tuple[Scenario, Evaluation]:
    """Two vehicles fly along x at different y past cylinders at x = 3 and 50 m, 1 m a step."""
    scenario = Scenario.between([0, 0, -8], [60, 0, -8], [[0, 0, -8, 0]] * 2, obstacles=CYLINDERS, duration=DT * STEPS)
    components = torch.zeros(STEPS + 1, 8, 1, 2, dtype=torch.float64)
    components[:, 0, 0] = torch.arange(STEPS + 1.0, dtype=torch.float64)[:, None]
    components[:, 1, 0] = torch.tensor(y, dtype=torch.float64)
    end = WorldState.of(VehicleState(components[-1]), STEPS)
    trajectory = Trajectory(components, torch.zeros(STEPS, 1, 2, 4, dtype=torch.float64), DT, 0, end)
    links = torch.full((STEPS + 1, 1, 3), final, dtype=torch.float64)
    nothing = torch.zeros(STEPS, 1, 2, dtype=torch.bool)
    return scenario, Evaluation(
        trajectory,
        links,
        100.0,
        scenario.clearance(trajectory.states.position, trajectory.time[:, None]),
        torch.zeros(1, 2, dtype=torch.bool),
        {"link": torch.tensor([1.5])},
        nothing,
        nothing,
    )


def test_nothing_is_said_of_a_good_mission():
    assert list(flight_warnings(*mission())) == []


def test_what_no_planner_reaches_is_said_first(make_relay):
    """2 m/s at most: 500 m take longer than 80 s; and over hops of 5 km nothing is heard."""
    assert list(mission_warnings(make_relay())) == []
    nodes = ("scenario.source_m=[-5000,0,-8]", "scenario.destination_m=[5000,0,-8]")
    near, far = (make_relay(*nodes, f"scenario.start=[[{x},0,-8,0]]", "channel=paper") for x in (2, 500))
    (silent,) = mission_warnings(near)
    assert silent.startswith("channel: even at the best places the chain carries only 4.6e-08 kbit/s")
    _, late = mission_warnings(far)
    assert late.startswith("scenario.duration_s: 80 s are too short: vehicle 1 starts 500 m from its target, at least ")
    need = float(late.removesuffix(" s away at full thrust").rsplit(" ", 1)[1])
    # Full thrust ahead alone, and with as much to the side on top.
    ahead, aside = ((-a + (a * a + 340.0 * b) ** 0.5) / (2.0 * b) for a, b in ((4.03, 18.18), (6.22, 21.66)))
    assert need == pytest.approx(500.0 / (ahead**2 + aside**2) ** 0.5, abs=0.5)


def test_who_hit_what_when_and_how_deep():
    """Straight through the second cylinder, of radius 1 m, with a hull of 0.3 m: it touches from x = 2 to 4 m."""
    assert list(flight_warnings(*mission((0.0, 20.0)))) == [
        "vehicle 1 hit obstacles: 1 contacts, first at 1.00 s, the deepest 1.30 m into obstacle 2, at 1.50 s"
    ]


def test_vehicles_that_collide():
    assert list(flight_warnings(*mission((10.0, 10.4)))) == ["vehicles 1 and 2 collided: 0.20 m deep at 0.00 s"]


def test_blocked_is_the_reason_for_not_arriving():
    scenario, evaluation = mission(final=50.0)
    (short,) = flight_warnings(scenario, evaluation)
    assert short.startswith("the chain does not keep 99 % of its best capacity: it ends with 50.000 of 100.000 kbit/s")
    (blocked,) = flight_warnings(scenario, replace(evaluation, blocked=torch.tensor([[False, True]])))
    assert blocked.startswith("vehicle 2 is blocked: ")


def test_saturated_thrusters():
    scenario, evaluation = mission()
    saturated = torch.tensor([False, True]).expand(STEPS, 1, 2)
    (sentence,) = flight_warnings(scenario, replace(evaluation, saturated=saturated))
    assert sentence == "a thruster limit of vehicle 2 is reached in 100% of the control steps"


@pytest.mark.parametrize(
    ("costs", "start", "end", "said"),
    [
        ([3.3, 3.2], 3.3, 3.2, []),
        ([3.19, 3.2], 3.3, 3.2, []),  # better by chance
        ([3.2, 11.272], 11.165, 11.272, ["worse than the start policy: J 11.272 instead of 11.165", "iterate 1, the"]),
        ([float("nan"), 3.1, 3.2], 3.3, 3.2, ["worse than iterate 2, the best: J 3.200 instead of 3.100"]),
        ([3.1, float("inf")], 3.3, float("nan"), ["start policy: J nan", "iterate 1"]),
    ],
)
def test_learning_that_ended_badly(costs, start, end, said):
    last = [SimpleNamespace(converged=True)]
    sentences = list(learning_warnings(last, costs, start, end))
    assert len(sentences) == len(said)
    assert all(part in sentence for part, sentence in zip(said, sentences, strict=True))


def test_learning_that_did_not_converge():
    last = [SimpleNamespace(converged=False, seconds=600.0, weight_change=change) for change in (0.25, 0.01)]
    (sentence,) = learning_warnings(last, [3.3, 3.2], 3.3, 3.2)
    assert sentence.startswith("learning did not converge within 600 s of flight: weights still change by 2.5e-01")


def outcomes(**given: list) -> Outcomes:
    """Three worlds with a free route in which all went well, but for what is given."""
    good = {"kind": [0, 0, 1], "feasible": [True] * 3, "ambiguous": [False] * 3, "blocked": [False] * 3}
    good |= {field.name: [0.0] * 3 for field in fields(Outcomes) if field.name not in good}
    return Outcomes(**{name: torch.tensor(value) for name, value in (good | given).items()})


def test_campaigns():
    assert list(campaign_warnings(outcomes())) == []
    # No way means to be blocked, and not to arrive.
    closed = outcomes(feasible=[True, True, False], blocked=[False, False, True], t99=[1.0, 2.0, float("inf")])
    assert list(campaign_warnings(closed)) == []
    bad = outcomes(
        collisions=[0, 3, 0], clearance=[1.0, -0.5, 1.0], blocked=[True, False, False], t99=[9e9, torch.inf, 1]
    )
    assert list(campaign_warnings(bad)) == [
        "obstacles were hit in 1 of 3 worlds, at most 0.50 m deep",
        "vehicles report to be blocked in 1 of 3 worlds that have a free route",
        "99 % of the best capacity is not kept in 1 of 3 worlds that have a free route",
    ]


def test_rows_of_the_table():
    _, evaluation = mission((0.0, 20.0))
    acted = torch.zeros(STEPS, 1, 2, dtype=torch.bool)
    acted[1, 0, 0] = True
    flown = replace(evaluation, intervened=acted, blocked=torch.tensor([[True, True]]))
    head, start, own = table({"start policy": replace(evaluation, intervened=None), "irl": flown}, converged=False)
    assert max(map(len, (head, start, own))) <= 120
    assert head.split()[-6:] == ["clear", "(m)", "blocked", "guard", "acts", "converged"]
    assert start.split()[-5:] == ["1", "-1.30", "0", "-", "-"]
    assert own.split()[-6:] == ["1", "-1.30", "2", "1", "(25.0%)", "no"]
    # Free water has no clearance.
    free = replace(evaluation, clearance=torch.full_like(evaluation.clearance, torch.inf))
    assert list(table({"pd": free}))[1].split()[-6:] == ["0", "-", "0", "0", "(0.0%)", "-"]
