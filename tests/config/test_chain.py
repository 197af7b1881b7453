"""Vehicles that are given by their number: where they start."""

from __future__ import annotations

import math

import pytest

from uwirl.config.cautions import cautions
from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose
from uwirl.config.validate import validate

FREE = "experiment=fig5_free"


@pytest.mark.parametrize("vehicles", [1, 2, 5, 10])
@pytest.mark.parametrize(
    "link",
    [
        "",
        "scenario.source_m=[0,0,-30] scenario.destination_m=[0,0,-1] scenario.depth_m=40",
        "scenario.source_m=[10,0,-38] scenario.destination_m=[0,0,-1] scenario.depth_m=40",
        "scenario.source_m=[0,0,-5] scenario.destination_m=[0,-900,-5]",
        # On the left, so that some must start elsewhere.
        "scenario.obstacles=[{center_m:[-12,3],radius_m:2,influence_m:6},{center_m:[-6,12],radius_m:2,influence_m:6}]",
    ],
)
def test_a_chain_starts_in_order_apart_and_free(vehicles: int, link: str):
    config = compose([FREE, f"scenario.vehicles={vehicles}", *link.split()])
    validate(config)
    assert not list(cautions(config))
    scenario = config.scenario
    assert len(scenario.start) == vehicles
    assert scenario.vehicles is None
    for i, (*position, _) in enumerate(scenario.start, 1):
        ends = zip(scenario.source_m, scenario.destination_m, strict=True)
        place = [a + i / (vehicles + 1) * (b - a) for a, b in ends]
        ways = [b - a for a, b in zip(scenario.source_m, scenario.destination_m, strict=True)]
        # Abreast: at a right angle to the link, as deep.
        assert sum(w * (p - q) for w, p, q in zip(ways, position, place, strict=True)) == pytest.approx(0.0, abs=1e-6)
        assert position[2] == pytest.approx(place[2])
        assert math.dist(position, place) > 0.5
        for obstacle in scenario.obstacles:
            assert math.dist(position[:2], obstacle.center_m) > obstacle.influence_m


def test_the_rule():
    # Two hops of 3.0 m along x; left of it is +y.
    line = "scenario.source_m=[0,0,-8] scenario.destination_m=[9,0,-8] scenario.vehicles=2"
    assert compose([FREE, *line.split()]).scenario.start == [[3.0, 3.0, -8.0, 0.0], [6.0, 3.0, -8.0, 0.0]]


@pytest.mark.parametrize("start", ["scenario.start=[[1,2,-3,0]]", "scenario.start.0=[1,2,-3,0]"])
def test_both_are_refused(start: str):
    with pytest.raises(ConfigError, match=r"scenario\.vehicles: spreads the vehicles by itself; leave it or"):
        compose(["scenario.vehicles=2", start])
    assert compose(["scenario.vehicles=null", start]).scenario.start == [[1, 2, -3, 0]]


@pytest.mark.parametrize("vehicles", ["0", "-1"])
def test_no_vehicles_are_refused(vehicles: str):
    with pytest.raises(ConfigError, match=r"scenario\.vehicles: must be at least 1"):
        validate(compose([f"scenario.vehicles={vehicles}"]))
