"""Learning in flight goes on from any leg as if it had never been interrupted, bitwise."""

import pytest
import torch

from uwirl import build
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.study import checkpoint
from uwirl.study.learning_file import history_of, learner_of, restore

SHORT = ("experiment=fig5_free", "planner.max_time_s=29", "planner.tolerance_weights=0")
RING = "scenario.obstacles=[{center_m:[21,20],radius_m:2,influence_m:6}]"
PAIR = "scenario.start=[[29.5,29.5,0,1],[25,20,-3,2]]"
PARALLEL = ("experience=parallel", "experience.worlds=4", "experience.leg_s=2", "planner.max_time_s=46")


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
    env = build.make_relay(config)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator))
    whole, files = [], []
    planner = build.make_planner(config, config.planner, env)
    for record in planner.iterate(env, estimate):
        whole.append(record)
        if record.closes:
            files.append(tmp_path / f"{len(files)}.pt")
            checkpoint.save(files[-1], {"learner": learner_of(planner.state), "history": history_of(whole)})
    assert len(files) >= 3
    # After the first leg, one in the middle, and the last, whence there is nothing more to learn.
    for path in (files[0], files[len(files) // 2], files[-1]):
        state, records = restore(path, checkpoint.load(path))
        again = build.make_planner(config, config.planner, build.make_relay(config))
        rest = list(again.iterate(build.make_relay(config), estimate, state))
        assert len(records) + len(rest) == len(whole)
        for found, expected in zip([*records, *rest], whole, strict=True):
            assert found.iteration == expected.iteration
            assert (found.seconds, found.rows, found.weight_change) == (
                expected.seconds,
                expected.rows,
                expected.weight_change,
            )
            assert torch.equal(found.actor, expected.actor)
            assert torch.equal(found.critic, expected.critic)
        assert torch.equal(again.policy.actor.weight, planner.policy.actor.weight)
        assert torch.equal(again.policy.trim, planner.policy.trim)
        assert torch.equal(again.start_weights, planner.start_weights)
        assert again.recorder.contacts == planner.recorder.contacts
        assert torch.equal(again.state.flight.components, planner.state.flight.components)
        assert again.state.flight[1:] == planner.state.flight[1:]


def test_given_weights_are_the_start(make_config):
    config = make_config(*SHORT)
    env = build.make_relay(config)
    _, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator))
    planner = build.make_planner(config, config.planner, env)
    planner.given = lambda basis, learners: (0.9 * basis.start_weights()).expand(learners, -1).clone()
    next(planner.iterate(env, estimate))
    assert torch.equal(planner.start_weights[0], 0.9 * planner.basis.start_weights())
    # Learning sets the policy's weights in place: not those.
    assert not torch.equal(planner.policy.actor.weight, planner.start_weights)
