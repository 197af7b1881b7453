"""Learning to the end, as the scripts of this folder need it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from uwirl import build
from uwirl.algorithm import Event, Improved, Start, algorithm_1
from uwirl.config.schema import Config
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.motion.planner import Planner
from uwirl.study.progress import bar
from uwirl.world.agent import Agent
from uwirl.world.relay import Relay


class Learned(NamedTuple):
    """What was learned, and how.

    Attributes:
        learning: the problem.
        state: when it was over.
        records: of all policy iterations.
    """

    learning: Learning
    state: LearningState
    records: list[IterationRecord]

    def agent_in(self, worlds: Relay) -> Agent:
        """The agent in other worlds between the same nodes, see `Learning.agent`."""
        return self.learning.agent(self.state.learner.actor, self.state.trim, worlds, self.state.known)


def shown(events: Iterator[Event], config: Config) -> Iterator[Event]:
    """Events of Algorithm 1, with a bar of the vehicle time on a terminal."""
    total = getattr(config.planner, "max_time_s", 0.0)
    with bar("learning", total, config.logging.progress and total > 0.0) as progress:
        for event in events:
            if isinstance(event, Improved):
                progress.update(min(event.state.seconds, total) - progress.n)
            yield event


def learn(config: Config, env: Relay, planner: Planner | None = None, start: Start | None = None) -> Learned:
    """Run Algorithm 1.

    Args:
        config: names estimator and planner.
        env: where vehicles fly to learn.
        planner: instead of the configuration's.
        start: what is known before.

    Raises:
        SystemExit: the planner does not learn.
    """
    planner = planner or build.make_planner(config, config.planner, env)
    if not isinstance(planner, IrlPlanner):
        raise SystemExit(f"planner={config.planner.name} does not learn")
    records = []
    for event in shown(algorithm_1(env, build.make_estimator(config.estimator, env), planner, start), config):
        if isinstance(event, Improved):
            records += event.records
            learning, state = event.learning, event.state
    return Learned(learning, state, records)
