"""Algorithm 1: estimate the channel, then fly, evaluate and improve until nothing changes any more.

A generator of events. It neither logs, nor draws, nor saves: listeners do so (`uwirl.runs.listeners`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.identified_planner import IdentifiedPlanner, Learned
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.motion.planner import Planner, fitted
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import Estimator, estimate_each_vehicle
from uwirl.world.agent import Agent
from uwirl.world.readings import Readings, readings_of_each_vehicle
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory


@dataclass(frozen=True)
class Start:
    """What is known before a run.

    Attributes:
        estimate: the channel estimate; None to make one from readings.
        weights: returns the weights to start learning with, [L, n3]; None for those of the basis.
        state: returns the state from which learning continues; None to begin.
    """

    estimate: ChannelEstimate | None = None
    weights: Callable[[Learning], Tensor] | None = None
    state: Callable[[Learning], LearningState] | None = None


class Estimated(NamedTuple):
    """The end of stage 1: each vehicle's readings, and the channel estimated from them, [M] data sets."""

    readings: list[Readings]
    estimate: ChannelEstimate


class Improved(NamedTuple):
    """The end of a leg of the learning flight.

    Attributes:
        learning: the problem.
        state: after the leg.
        records: one for each policy iteration after it.
        flown: the leg.
    """

    learning: Learning
    state: LearningState
    records: list[IterationRecord]
    flown: Trajectory


class Modelled(NamedTuple):
    """The end of a leg of a flight that identifies a model: names of its parameters, and what is known of them."""

    names: tuple[str, ...]
    learned: Learned


class Planned(NamedTuple):
    """The end of stage 2: the agent for any worlds between the same nodes, and how it was learned; None if planned."""

    agent_in: Callable[[Relay], Agent]
    learned: tuple[Learning, LearningState] | None


Event = Estimated | Improved | Modelled | Planned


@torch.no_grad()
def algorithm_1(env: Relay, estimator: Estimator, planner: Planner, start: Start | None = None) -> Iterator[Event]:
    """Run Algorithm 1.

    Args:
        env: the worlds in which the vehicles receive messages and fly to learn.
        estimator: estimates the channel, stage 1.
        planner: plans or learns, stage 2.
        start: what is known before; None for nothing.

    Yields:
        Estimated, then Improved or Modelled after each leg if the planner learns, then Planned.
    """
    start = start or Start()
    if start.estimate is None:
        readings, estimate = estimate_each_vehicle(env, estimator)
    else:
        readings, estimate = readings_of_each_vehicle(env), start.estimate
    yield Estimated(readings, estimate)

    if isinstance(planner, IdentifiedPlanner):
        for learned in planner.learn(env, estimate):
            yield Modelled(planner.regressor.names, learned)
        yield Planned(lambda worlds: planner.agent(worlds, estimate, learned), None)
        return
    if not isinstance(planner, IrlPlanner):
        yield Planned(lambda worlds: fitted(planner, worlds, estimate), None)
        return

    learning = Learning(planner, env, estimate)
    state = start.state(learning) if start.state else learning.init(start.weights and start.weights(learning))
    while not learning.is_over(state):
        leg, state = learning.fly(state)
        state = learning.improve(state, leg)
        yield Improved(learning, state, learning.records(state), leg.flown)
    yield Planned(
        lambda worlds: learning.agent(state.learner.actor, state.trim, worlds, state.known), (learning, state)
    )
