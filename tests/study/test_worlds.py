"""Extreme worlds of experiments/worlds.py: flown for a moment, or refused with the key that is wrong."""

from __future__ import annotations

import math

import pytest
import torch
from worlds import world

from uwirl import build
from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study import shadowing

BRIEF = ["planner=pd", "planner.calibration_s=5", "scenario.duration_s=1"]


@pytest.mark.parametrize("k", [0, 16, 31, 45, 48])
def test_extreme_worlds_fly(k: int):
    """0.5 m flat, 10 vehicles on 13 m, 263 m vertical, 4 km for two, 8 km flat."""
    config = compose([*world(k, 50).overrides, *BRIEF])
    validate(config)
    env = build.make_relay(config)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    with torch.no_grad():
        agent = build.make_planner(config, config.planner, env).fit(env, estimate)
        evaluator = build.make_evaluator(config, env)
        flown = evaluator.fly(agent)
        capacities = shadowing.shadowed_capacities(env, flown.trajectory, evaluator.mission.targets)
    assert int(flown.metrics()["collisions"]) == 0
    assert math.isfinite(float(flown.cost[0]))
    assert 0.0 < capacities["capacity_initial_kbps"] <= capacities["capacity_optimal_kbps"]


@pytest.mark.parametrize(("k", "key"), [(1, "scenario.start"), (5, "scenario.start"), (47, "guidance.spacing_m")])
def test_impossible_worlds_are_refused(k: int, key: str):
    """More vehicles than have room, and maps for three of them along 6.7 km."""
    with pytest.raises(ConfigError) as caught:
        validate(compose([*world(k, 50).overrides, *BRIEF]))
    assert caught.value.key == key
    assert "fit" in str(caught.value) or "choose at least" in str(caught.value)
