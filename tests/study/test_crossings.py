"""Vehicles that swap ends and learners in clutter: worlds are as promised, and what is counted is what happened."""

import runpy
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from uwirl.motion.safety import Unguarded
from uwirl.motion.targets import mean_channel_targets
from uwirl.study.campaign import Outcomes
from uwirl.world.agent import Feedback, Guarded
from uwirl.world.obstacles import no_obstacles
from uwirl.world.random import RandomStreams
from uwirl.world.truth import truth_of

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def settings_of(name: str, **changes):
    return OmegaConf.merge(OmegaConf.load(EXPERIMENTS / "conf" / f"{name}.yaml"), changes)


@pytest.fixture(scope="module")
def crossing():
    return runpy.run_path(str(EXPERIMENTS / "crossings.py"))


@pytest.fixture(scope="module")
def clutter():
    return runpy.run_path(str(EXPERIMENTS / "learning_in_clutter.py"))


def test_swaps_start_at_each_others_targets_with_room_for_all(crossing, make_relay):
    env = make_relay("experiment=fig5_single", streams=RandomStreams.worlds(5, 24))
    env = env.on(replace(env.scenario, start=torch.zeros(3, 4).double(), obstacles=no_obstacles()), env.streams)
    worlds, layouts = crossing["swapped"](env, ["random", "overlapping"], 10)
    frame = mean_channel_targets(env.scenario, truth_of(env).channel).frame
    away = torch.linalg.vector_norm(layouts.start[..., :3] - frame.target.flip(0), dim=-1)
    assert worlds.worlds == len(layouts.kind) == 11
    assert 0.0 < float(away[:-1].amin())
    assert float(away.amax()) < 5.0 * 0.3
    assert float(layouts.obstacles.clearance(layouts.start[..., :3], 0.3).min()) >= 0.5
    assert bool(layouts.feasible(frame.target, 0.45).all())
    assert bool(layouts.obstacles.present[:-1].any(-1).all())
    # The last one: exactly head-on, in free water.
    assert not bool(layouts.obstacles.present[-1].any())
    assert torch.equal(layouts.start[-1], torch.cat([frame.target.flip(0), frame.bearing[:, None]], -1))


def test_vehicles_pass_each_other_with_the_weights_of_one(crossing):
    overrides = ["experiment=fig5_single", "scenario.duration_s=44", "planner.max_time_s=20", "guidance.spacing_m=1"]
    settings = settings_of("crossings", vehicles=[2], worlds=2)
    settings.overrides = overrides
    with torch.no_grad():
        metrics = crossing["crossings"](settings)
    assert (metrics["worlds"], metrics["swap_2_worlds"], metrics["cross_2_worlds"]) == (3, 2, 1)
    assert (metrics["collisions"], metrics["vehicle_collisions"], metrics["swap_2_reach_rate"]) == (0, 0, 1.0)
    # They did meet, and kept what the guard promises.
    assert 0.99 < metrics["swap_2_min_vehicle_separation_m"] < 6.0


def test_vehicles_collide_below_two_radii(crossing):
    separation = torch.tensor([0.59, 0.61, torch.inf])
    yes, zero = torch.ones(3, dtype=torch.bool), torch.zeros(3)
    outcomes = Outcomes(
        zero.long(), yes, ~yes, zero.long(), zero + 1.0, separation, zero, ~yes, zero, zero.long(), zero
    )
    metrics = crossing["summary"](outcomes, 0.6)
    assert (metrics["vehicle_collisions"], metrics["min_vehicle_separation_m"]) == (1, pytest.approx(0.59))


def test_watched_guard_notes_the_smallest_clearance(clutter, make_relay):
    env = make_relay("experiment=fig5_single", "scenario.start=[[25,20,-4,3.14]]")
    watched = clutter["Watched"](Unguarded(), env)
    ahead = torch.tensor([[[60.0, 0.0, 2.0, 0.0]]], dtype=torch.float64)
    flown = env.rollout(Guarded(Feedback(lambda observation: ahead), watched), steps=200)
    clearance = env.scenario.clearance(flown.states.position)[:-1].amin()
    assert float(clearance) < 0.0
    torch.testing.assert_close(watched.clearance, clearance[None], rtol=0, atol=0)


def test_learners_in_clutter_touch_nothing(clutter):
    settings = settings_of("learning_in_clutter", worlds=2)
    settings.overrides = ["experiment=random_layouts", "planner.max_time_s=20", "scenario.duration_s=1"]
    with torch.no_grad():
        metrics = clutter["learning_in_clutter"](settings)
    # 14 s of hovering and two legs of 5 s, in each of two worlds.
    assert metrics["learning_vehicle_seconds"] == metrics["unguarded_learning_vehicle_seconds"] == 2 * 24.0
    assert (metrics["learning_collisions"], metrics["learning_worlds_with_collision"]) == (0, 0)
    assert metrics["learning_min_obstacle_clearance_m"] > 0.0
