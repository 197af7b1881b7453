"""planner=irl: model-free integral reinforcement learning (Algorithm 1, second loop)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.solvers import Bounds, Solver
from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.experience import ExperienceSource
from uwirl.motion.features import MotionBasis
from uwirl.motion.guidance import Guidance
from uwirl.motion.learning import Learning
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent, Guard
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class IrlPlanner:
    """The settings of learning; what is learned stands in the state of a `Learning`.

    Attributes:
        cost: weights of the running cost.
        basis: features of critic and actor for a running cost.
        solver: from the Bellman operator and the actor's bounds.
        experience: where experience comes from.
        guard: between policy and thrusters while learning.
        guidance: the mission's way to the target; virtual links are flown to straight.
        inertia_lower: declared lower bound of each axis' inertia, kg, kg m^2: all the learner is told of the dynamics.
        start_gain: scales the start policy.
        calibration_s: duration of the calibration hover, s; it counts as vehicle time.
        window_s: T of the integration windows, s.
        stride_s: between the beginnings of two windows, s.
        residual_floor: see Recorder.
        updates: policy iterations after each leg.
        actor_sign: "corrected", or "printed" as in the paper, which fails.
        tolerance_weights: epsilon_3.
        tolerance_inverse_capacity: epsilon_4, s/kbit.
        max_time_s: T_max,2, of vehicle time, s.
    """

    cost: CostWeights
    basis: Callable[[RelayCost], MotionBasis]
    solver: Callable[[BellmanOperator, Bounds], Solver]
    experience: ExperienceSource
    guard: Guard
    guidance: Guidance
    inertia_lower: Sequence[float]
    start_gain: float
    calibration_s: float
    window_s: float
    stride_s: float
    residual_floor: float
    updates: int
    actor_sign: str
    tolerance_weights: float
    tolerance_inverse_capacity: float
    max_time_s: float

    @property
    def sign(self) -> float:
        """Of the actor's part in the Bellman equation."""
        return -1.0 if self.actor_sign == "corrected" else 1.0

    @torch.no_grad()
    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Learn to the end; `uwirl.algorithm` has the same loop, watched."""
        learning = Learning(self, env, estimate)
        state = learning.init()
        while not learning.is_over(state):
            leg, state = learning.fly(state)
            state = learning.improve(state, leg)
        return learning.agent(state.learner.actor, state.trim)
