"""Campaigns over random layouts: what is counted, and how sure one can be."""

import math
from dataclasses import replace

import pytest
import torch
from scipy import stats

from uwirl import build
from uwirl.config.world_schema import LayoutKind
from uwirl.runs.missions import campaign
from uwirl.snr.estimators import oracle
from uwirl.study.campaign import Outcomes, fly, upper_bound
from uwirl.world.layouts import KINDS
from uwirl.world.readings import take_readings
from uwirl.world.truth import truth_of

SMALL = (
    "experiment=random_layouts",
    "planner=pd",
    "guidance.spacing_m=1",
    "scenario.layouts.count=8",
    "scenario.layouts.seed=1",
    "scenario.layouts.kinds=[random,ring,ring,ring]",
    "scenario.duration_s=40",
    "logging.figures=false",
)


@pytest.mark.parametrize(("failures", "trials"), [(0, 1), (0, 1882), (3, 1882), (5, 20), (19, 20)])
def test_upper_bound_is_clopper_pearsons(failures, trials):
    exact = stats.binomtest(failures, trials, alternative="less").proportion_ci(0.95, "exact").high
    assert upper_bound(failures, trials) == pytest.approx(exact, rel=1e-9)


def test_upper_bound_at_the_ends():
    assert upper_bound(7, 7) == 1.0
    assert math.isnan(upper_bound(0, 0))


def test_configuration_knows_the_kinds_of_layouts():
    assert tuple(LayoutKind) == KINDS


@pytest.fixture(scope="module")
def flown(make_config):
    config = make_config(*SMALL)
    env, layouts = build.make_layouts(config)
    training = build.make_relay(config)
    truth = oracle(take_readings(training), training.budget, truth_of(training).channel)
    planner = build.make_planner(config, config.planner, training)

    def agent_in(worlds):
        return planner.fit(worlds, truth)

    evaluator = build.make_evaluator(config, env)
    outcomes = fly(env, layouts, agent_in, evaluator, batch=5)
    return config, env, layouts, agent_in, evaluator, outcomes


def test_outcomes_are_those_of_single_missions(flown):
    _, env, layouts, agent_in, evaluator, outcomes = flown
    common = replace(env.scenario, start=layouts.start, obstacles=layouts.obstacles)
    one = env.on(common, env.streams).select(torch.tensor([4]))
    alone = evaluator.in_worlds(one).fly(agent_in(one))
    assert float(outcomes.cost[4]) == pytest.approx(float(alone.cost), rel=1e-9)
    assert float(outcomes.clearance[4]) == pytest.approx(float(alone.clearance.min()), rel=1e-9)
    assert float(outcomes.t99[4]) == (alone.time_to_99_percent() or math.inf)


def test_blocked_are_those_without_a_way_and_nobody_touches(flown):
    outcomes = flown[-1]
    assert not bool(outcomes.ambiguous.any())
    assert 0 < int((~outcomes.feasible).sum()) < 8
    assert torch.equal(outcomes.blocked, ~outcomes.feasible)
    assert int(outcomes.collisions.sum()) == 0


def test_metrics_and_table_count_alike(flown):
    outcomes: Outcomes = flown[-1]
    metrics = outcomes.metrics()
    assert metrics["worlds"] == 8
    assert metrics["worlds_feasible"] + metrics["worlds_infeasible"] == 8
    assert metrics["blocked"] == metrics["blocked_where_infeasible"] == metrics["worlds_infeasible"]
    assert metrics["reach_rate"] == pytest.approx(float(outcomes.reached[outcomes.feasible].double().mean()))
    rows = {line.split()[0]: line.split() for line in outcomes.table()}
    assert rows.keys() == {"kind", "random", "ring", "all"}
    assert int(rows["all"][2]) == metrics["worlds_feasible"]
    assert (int(rows["random"][1]), int(rows["ring"][1])) == (2, 6)


def test_the_app_leaves_every_layout_behind(flown, tmp_path):
    import numpy as np

    config, _, layouts, agent_in, *_ = flown
    metrics = campaign(config, agent_in, tmp_path)
    kept = np.load(tmp_path / "layouts.npz")
    assert kept["start"].shape == (8, 1, 4)
    assert (kept["kind"] == layouts.kind.numpy()).all()
    assert float(np.median(kept["cost"][kept["feasible"]])) == pytest.approx(metrics["cost_total_median"], rel=1e-2)
