"""experience=mission: the mission itself teaches, from nothing known."""

from __future__ import annotations

from functools import partial

import pytest

from uwirl import build
from uwirl.algorithm import Improved, Modelled, Planned, algorithm_1
from uwirl.snr.estimators import oracle
from uwirl.world.obstacles import contacts
from uwirl.world.trajectory import Trajectory
from uwirl.world.truth import truth_of

# J of the optimiser of experiments/compare.py between the same obstacles.
OPTIMUM = 3.273


@pytest.fixture(scope="module", params=["irl", "identified"])
def flown(request, make_config, make_relay):
    """Events of Algorithm 1, the first mission's evaluation, and that of the policy afterwards."""
    words = ("experiment=fig5_single", "experience=mission", f"planner={request.param}")
    config, env = make_config(*words), make_relay(*words)
    estimator = partial(oracle, channel=truth_of(env).channel)
    events = list(algorithm_1(env, estimator, build.make_planner(config, config.planner, env)))
    legs = [event.flown if isinstance(event, Improved) else event.learned.flown for event in events[1:-1]]
    evaluator, planned = build.make_evaluator(config, env), events[-1]
    assert isinstance(planned, Planned)
    first = evaluator.judge(Trajectory.joined(legs))
    return env, events, first, evaluator.fly(planned.agent_in(env))


def test_one_mission_from_nothing(flown):
    env, events, first, after = flown
    assert len(first.trajectory.tau) == env.scenario.steps
    assert first.trajectory.first_step == 0
    assert not bool(contacts(first.clearance).any())
    assert first.time_to_99_percent() is not None
    share = 1.10 if isinstance(events[1], Improved) else 1.06
    assert float(first.cost) < share * OPTIMUM
    assert float(after.cost) < 1.01 * OPTIMUM


def test_what_is_known_begins_with_nothing_and_ends_with_the_truth(flown):
    env, events, _, _ = flown
    if isinstance(events[1], Improved):
        early, late = events[1].state.known, events[-2].state.known
    else:
        assert isinstance(events[-2], Modelled)
        early, late = events[1].learned.identified, events[-2].learned.identified
    assert early is None
    assert late.theta[:4].tolist() == pytest.approx(env.vehicle.inertia.tolist(), rel=0.01)


def test_the_next_mission_begins_at_the_start(make_config, make_relay):
    words = ("experiment=fig5_free", "experience=mission", "scenario.duration_s=6", "planner.max_time_s=9")
    config, env = make_config(*words), make_relay(*words)
    estimator = partial(oracle, channel=truth_of(env).channel)
    events = algorithm_1(env, estimator, build.make_planner(config, config.planner, env))
    improved = [event for event in events if isinstance(event, Improved)]
    legs = [event.flown for event in improved]
    # A log of each mission, with no window across the jump.
    assert [len(log.tau) for log in improved[-1].state.logs] == [120, 60]
    assert [leg.first_step for leg in legs] == [20 * k for k in range(9)]
    assert (legs[6].eta[0] == legs[0].eta[0]).all()
    assert (legs[5].eta[0] == legs[4].eta[-1]).all()
