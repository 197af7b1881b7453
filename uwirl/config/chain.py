"""A chain that is given by its number of vehicles: where they start. Knows no torch."""

from __future__ import annotations

import math
from dataclasses import replace

from uwirl.config.checks import numbers
from uwirl.config.schema import Config
from uwirl.config.world_schema import ScenarioConfig

# Farthest from its place beside the link that a vehicle starts in free water, m.
FARTHEST_M = 20.0
# Distances that are tried among obstacles, each a quarter longer than the first one.
TRIED = 400


def spread(config: Config) -> Config:
    """The configuration with `scenario.start` in the place of `scenario.vehicles`, if this is given and possible.

    Vehicle i of M starts abreast of its place, i / (M + 1) of the way from source to destination, as deep, one hop
    (at most FARTHEST_M) to the left seen from above; where an obstacle has influence, to the right, or farther away.
    """
    scenario = config.scenario
    ends = (scenario.source_m, scenario.destination_m)
    if scenario.vehicles is None or scenario.vehicles < 1 or any(map(numbers(3), ends)):
        # Which `validate` refuses.
        return config
    start = [_start(scenario, i / (scenario.vehicles + 1)) for i in range(1, scenario.vehicles + 1)]
    return replace(config, scenario=replace(scenario, vehicles=None, start=start))


def _start(scenario: ScenarioConfig, share: float) -> list[float]:
    """eta at this share of the way."""
    assert scenario.vehicles is not None
    ends = list(zip(scenario.source_m, scenario.destination_m, strict=True))
    x, y, z = (a + share * (b - a) for a, b in ends)
    east, north = (b - a for a, b in ends[:2])
    flat = math.hypot(east, north)
    # Any side will do for a vertical link.
    side = (-north / flat, east / flat) if flat > 0.0 else (1.0, 0.0)
    hop = min(math.dist(*zip(*ends, strict=True)) / (scenario.vehicles + 1), FARTHEST_M)
    tried = (sign * hop * (1.0 + k / 4.0) for k in range(TRIED) for sign in (1.0, -1.0))
    places = ([x + d * side[0], y + d * side[1]] for d in tried)
    reach = scenario.vehicle_radius_m
    free = (
        place
        for place in places
        if all(math.dist(place, o.center_m) > max(o.influence_m, o.radius_m) + reach for o in scenario.obstacles)
    )
    return [*next(free, [x + hop * side[0], y + hop * side[1]]), z, 0.0]
