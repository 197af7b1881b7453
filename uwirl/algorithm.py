"""Algorithm 1: estimate the channel, then fly, evaluate and improve until nothing changes any more.

It yields what happens, and neither logs, nor draws, nor saves: who wants to do so listens (`uwirl.runs.listeners`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.motion.planner import Planner
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import Estimator
from uwirl.world.agent import Agent
from uwirl.world.readings import Readings, readings_of_each_vehicle
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Start:
    """What is known before a run.

    Attributes:
        estimate: of the channel; None to make one from readings.
        weights: those to start learning from; None for the basis' own.
        state: of learning that goes on; None to begin.
    """

    estimate: ChannelEstimate | None = None
    weights: Callable[[Learning], Tensor] | None = None
    state: Callable[[Learning], LearningState] | None = None


class Estimated(NamedTuple):
    """Stage 1 is over: each vehicle's readings, and the channel behind them."""

    readings: list[Readings]
    estimate: ChannelEstimate


class Improved(NamedTuple):
    """A leg was flown, and its experience taken in; `records` holds one for each policy iteration after it."""

    learning: Learning
    state: LearningState
    records: list[IterationRecord]


class Planned(NamedTuple):
    """Stage 2 is over: the agent, for any worlds between the same nodes, and how it was learned if it was."""

    agent_in: Callable[[Relay], Agent]
    learned: tuple[Learning, LearningState] | None


Event = Estimated | Improved | Planned


@torch.no_grad()
def algorithm_1(env: Relay, estimator: Estimator, planner: Planner, start: Start | None = None) -> Iterator[Event]:
    """Run it.

    Args:
        env: where the vehicles are, and fly to learn.
        estimator: of stage 1.
        planner: of stage 2; one that learns is watched leg by leg.
        start: what is known before; None for nothing.

    Yields:
        Events as they happen; Planned is the last.
    """
    start = start or Start()
    readings = readings_of_each_vehicle(env)
    estimate = start.estimate
    if estimate is None:
        estimate = ChannelEstimate.join([estimator(data, env.budget) for data in readings])
    yield Estimated(readings, estimate)

    if not isinstance(planner, IrlPlanner):
        yield Planned(lambda worlds: planner.fit(worlds, estimate), None)
        return

    learning = Learning(planner, env, estimate)
    state = start.state(learning) if start.state else learning.init(start.weights and start.weights(learning))
    while not learning.is_over(state):
        leg, state = learning.fly(state)
        # Policy evaluation and improvement, several times: the same experience serves any policy.
        state = learning.improve(state, leg)
        yield Improved(learning, state, learning.records(state))
    yield Planned(lambda worlds: learning.agent(state.learner.actor, state.trim, worlds), (learning, state))
