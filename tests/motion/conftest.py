"""Missions on the true channel, and learning on what was estimated of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest

from uwirl import build
from uwirl.algorithm import Improved, algorithm_1
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.motion.mission import Mission
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

MakeMission = Callable[..., Mission]


class Learned(NamedTuple):
    env: Relay
    learning: Learning
    state: LearningState
    records: list[IterationRecord]


@pytest.fixture(scope="session")
def make_mission(make_config, make_relay) -> MakeMission:
    """make_mission("key=value", ..., streams=None): a configuration's, on the true channel."""

    def make(*overrides: str, streams: RandomStreams | None = None) -> Mission:
        env = make_relay(*overrides, streams=streams)
        return Mission(env, truth_of(env).channel, build.make_cost(make_config(*overrides).cost))

    return make


@pytest.fixture(scope="session")
def learn(make_config, make_relay) -> Callable[..., Learned]:
    """learn("key=value", ..., seeds=None): Algorithm 1 in Fig. 5's free water, a world for each seed."""

    def run(*overrides: str, seeds: Sequence[int] | None = None) -> Learned:
        overrides = ("experiment=fig5_free", *overrides)
        config = make_config(*overrides)
        env = make_relay(*overrides, streams=RandomStreams.replicates(seeds) if seeds else None)
        planner = build.make_planner(config, config.planner, env)
        assert isinstance(planner, IrlPlanner)
        events = list(algorithm_1(env, build.make_estimator(config.estimator, env), planner))
        learned = [event for event in events if isinstance(event, Improved)]
        return Learned(env, learned[-1].learning, learned[-1].state, [r for event in learned for r in event.records])

    return run
