"""Learning in flight is a function of its state, and goes on from any leg as if it had never been interrupted."""

from functools import partial

import pytest
import torch
from trees import assert_same, copied

from uwirl import build
from uwirl.algorithm import Improved, Start, algorithm_1
from uwirl.motion.learning import Learning
from uwirl.snr.estimators import estimate_each_vehicle, oracle
from uwirl.study import checkpoint
from uwirl.study.learning_file import history_of, learner_of, restore
from uwirl.world.truth import truth_of

SHORT = ("experiment=fig5_free", "planner.max_time_s=29", "planner.tolerance_weights=0")
RING = "scenario.obstacles=[{center_m:[21,20],radius_m:2,influence_m:6}]"
PAIR = "scenario.start=[[29.5,29.5,0,1],[25,20,-3,2]]"
PARALLEL = ("experience=parallel", "experience.worlds=4", "experience.leg_s=2", "planner.max_time_s=46")


def learn(config, start=None) -> list[Improved]:
    """In worlds and by a planner made for it alone."""
    env = build.make_relay(config)
    estimator, planner = partial(oracle, channel=truth_of(env).channel), build.make_planner(config, config.planner, env)
    return [event for event in algorithm_1(env, estimator, planner, start) if isinstance(event, Improved)]


@pytest.mark.parametrize(
    "overrides",
    [
        ("solver=z_rls",),
        ("solver=batch",),
        ("solver=rls_forgetting", "safety=barrier"),
        ("scenario.current_mps=[0.05,0.02,0]", "scenario.current_std_mps=0.02", PAIR, RING),
        (*PARALLEL, "dtype=float32"),
        (*PARALLEL, "solver=rls_paper"),
        (*PARALLEL, "basis=geodesic", RING),
    ],
    ids=["z_rls", "batch", "rls_forgetting", "pair in a current", "parallel", "parallel rls", "geodesic"],
)
def test_resumed_after_any_leg(make_config, tmp_path, overrides):
    config = make_config(*SHORT, *overrides)
    whole = learn(config)
    # Legs before there are as many rows as unknowns teach nothing yet, and nothing is saved of them.
    taught = [legs for legs, event in enumerate(whole, 1) if event.records]
    assert len(taught) >= 3
    # After the first one, one in the middle, and the last, whence there is nothing more to learn.
    for legs in (taught[0], taught[len(taught) // 2], taught[-1]):
        path = tmp_path / f"{legs}.pt"
        so_far = [record for event in whole[:legs] for record in event.records]
        checkpoint.save(path, {"learner": learner_of(whole[legs - 1].state), "history": history_of(so_far)})
        content = checkpoint.load(path)
        # The newest iterates are those of the history, and nothing to learn from.
        before = whole[legs - 1].state
        expected = before._replace(learner=before.learner._replace(iterates=()))
        assert_same(restore(whole[0].learning, content), expected)
        rest = learn(config, Start(state=lambda learning, content=content: restore(learning, content)))
        assert len(rest) == len(whole) - legs
        for found, original in zip(rest, whole[legs:], strict=True):
            assert_same(found.state, original.state)
            assert_same([vars(record) for record in found.records], [vars(record) for record in original.records])


@pytest.mark.parametrize("overrides", [(PAIR, RING), (*PARALLEL, "basis=geodesic", RING)], ids=["links", "parallel"])
def test_learning_is_a_function_of_its_state(make_config, make_relay, overrides):
    """A leg flown twice and learned from twice: bitwise the same, and the state given stays as it was."""
    config, env = make_config(*SHORT, *overrides), make_relay(*SHORT, *overrides)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    learning = Learning(build.make_planner(config, config.planner, env), env, estimate)
    state = learning.init()
    assert_same(state, learning.init())
    for _ in range(3):
        before = copied(state)
        first, second = learning.fly(state), learning.fly(state)
        assert_same(first, second)
        assert_same(state, before)
        leg, flown = first
        experience, flown_before = copied(leg), copied(flown)
        state = learning.improve(flown, leg)
        assert_same(state, learning.improve(flown, leg))
        assert_same((leg, flown), (experience, flown_before))
    assert state.learner.iteration >= 2 * config.planner.updates


def test_given_weights_are_the_start(make_config):
    config = make_config(*SHORT)
    given = 0.9 * learn(config)[0].learning.basis.start_weights()[None]
    kept = given.clone()
    events = learn(config, Start(weights=lambda learning: given))
    assert torch.equal(events[-1].state.start, given)
    assert torch.equal(given, kept)
    assert not torch.equal(events[-1].state.learner.actor, given)
