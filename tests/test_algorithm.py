"""What Algorithm 1 yields, in which order, and that whoever only wants the result gets the same."""

import pytest
import torch

from uwirl import build
from uwirl.algorithm import Estimated, Improved, Planned, Start, algorithm_1
from uwirl.motion.guidance import Geodesic
from uwirl.motion.route_view import LearnedGeodesic
from uwirl.snr.estimators import estimate_each_vehicle

SHORT = ("experiment=fig5_free", "planner.max_time_s=20", "planner.tolerance_weights=0")


@pytest.fixture
def stages(make_config):
    """stages("key=value", ...): environment, estimator and planner."""

    def make(*overrides: str):
        config = make_config(*overrides)
        env = build.make_relay(config)
        estimator = build.make_estimator(config.estimator, env)
        return env, estimator, build.make_planner(config, config.planner, env)

    return make


def test_a_planner_that_learns_is_watched_leg_by_leg(stages):
    env, estimator, planner = stages(*SHORT)
    events = list(algorithm_1(env, estimator, planner))
    # 14 s of hovering and two legs of 5 s.
    assert [type(event) for event in events] == [Estimated, Improved, Improved, Planned]
    estimated, *legs, planned = events
    assert estimated.estimate.theta.shape == (1, 2)
    assert [leg.state.seconds for leg in legs] == [19.0, 24.0]
    iterations = [record.iteration for leg in legs for record in leg.records]
    assert iterations == list(range(1, legs[-1].state.learner.iteration + 1))
    assert planned.learned is not None
    assert planned.learned[1] is legs[-1].state


def test_a_planner_that_does_not_learn_plans_at_once(stages):
    env, estimator, planner = stages("experiment=fig5_free", "planner=pd")
    events = list(algorithm_1(env, estimator, planner))
    assert [type(event) for event in events] == [Estimated, Planned]
    assert events[-1].learned is None
    agent, (_, observation) = events[-1].agent_in(env), env.reset()
    assert agent.act(agent.init(observation), observation)[0].shape == (1, 1, 4)


def test_a_custom_planner_with_a_basis_is_guided_as_its_basis_needs(stages):
    """The geodesic basis learns the speed along the route, so its agents cannot use the guidance of other agents."""
    geodesic = ("experiment=fig5_free", "basis=geodesic")
    custom = ("planner=custom", "planner.target=uwirl.motion.irl_planner.IrlPlanner")
    planners = [stages(*geodesic, *choice)[2] for choice in ((), custom, ("planner=pd",))]
    assert [type(planner.guidance) for planner in planners] == [LearnedGeodesic, LearnedGeodesic, Geodesic]


def test_nothing_is_estimated_that_is_known(stages):
    env, _, planner = stages("experiment=fig5_free", "planner=pd")
    _, known = estimate_each_vehicle(env, stages("experiment=fig5_free", "estimator=oracle")[1])

    def never(readings, budget):
        raise AssertionError("the channel was known")

    estimated = next(iter(algorithm_1(env, never, planner, Start(estimate=known))))
    assert estimated.estimate is known


def test_fitting_is_the_same_loop_unwatched(stages):
    """Of other objects, made from the same configuration: the agent flies bitwise the same."""
    overrides = (*SHORT, "scenario.duration_s=5")
    env, estimator, planner = stages(*overrides)
    *_, planned = algorithm_1(env, estimator, planner)
    other, same_estimator, same_planner = stages(*overrides)
    _, estimate = estimate_each_vehicle(other, same_estimator)
    agent = same_planner.fit(other, estimate)
    watched, unwatched = env.rollout(planned.agent_in(env)), other.rollout(agent)
    assert torch.equal(watched.components, unwatched.components)
    assert torch.equal(watched.tau, unwatched.tau)
