"""Planners: from an estimated channel to a policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.networks import LinearActor, LinearCritic
from uwirl.irl.policy_iteration import InsufficientDataError, IterationRecord, StoppingRule, policy_iteration
from uwirl.irl.solvers import Bounds, Experience, Solver
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import RelayCost
from uwirl.motion.experience import Recorder, Window
from uwirl.motion.features import MotionBasis
from uwirl.motion.guidance import Guidance, Lead
from uwirl.motion.policy import LinkFramePolicy, Policy
from uwirl.motion.safety import Guard
from uwirl.motion.targets import ChainTargets, mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.acoustics import Channel
from uwirl.world.relay import Relay, Trajectory


class Planner(Protocol):
    """Finds a policy; may fly in `env` to learn, but sees the channel through `estimate` only."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Policy: ...


class LearningPlanner(ABC):
    """A planner whose fit proceeds in iterations worth watching.

    Attributes:
        policy: the newest policy.
        lead: leads it to the mission's target.
        basis: its features.
        start_weights: what it started from, [L, n3].
        recorder: has counted the contacts while learning.
    """

    policy: LinkFramePolicy
    lead: Lead
    basis: MotionBasis
    start_weights: Tensor
    recorder: Recorder

    @abstractmethod
    def iterate(self, env: Relay, estimate: ChannelEstimate) -> Iterator[IterationRecord]:
        """Learn, one record an iteration."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Policy:
        """Learn to the end."""
        for _ in self.iterate(env, estimate):
            pass
        return self.lead(self.policy)


class ExperienceSource(Protocol):
    """Flies the newest policy and yields what it learned from."""

    def fly(
        self, env: Relay, hover: Trajectory, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Experience]: ...


CostFactory = Callable[[Channel, ChainTargets], RelayCost]


@dataclass
class IrlPlanner(LearningPlanner):
    """Model-free integral reinforcement learning (Algorithm 1, second loop).

    Attributes:
        make_cost: the running cost on an estimated channel.
        make_basis: features of critic and actor for that cost.
        make_solver: from the Bellman operator, the start weights [L, n3] and the bounds.
        experience: where experience comes from.
        learners: L, independent sets of weights: one for all, or one for each vehicle of each world.
        actor_sign: -1; +1 is the sign printed in the paper.
        inertia_lower: declared lower bound of each axis' inertia, kg, kg m^2: all the learner is told of the dynamics.
        start_gain: scales the start policy.
        calibration_s: duration of the calibration hover, s.
        window: integration windows.
        residual_floor: see Recorder.
        updates: policy iterations per stretch of experience.
        stopping: epsilon_3 and T_max,2; the hover counts towards the time.
        guard: between policy and thrusters while learning.
        guidance: the mission's way to the target; virtual links are flown to straight.
    """

    make_cost: CostFactory
    make_basis: Callable[[RelayCost], MotionBasis]
    make_solver: Callable[[BellmanOperator, Tensor, Bounds], Solver]
    experience: ExperienceSource
    learners: int
    actor_sign: float
    inertia_lower: tuple[float, ...]
    start_gain: float
    calibration_s: float
    window: Window
    residual_floor: float
    updates: int
    stopping: StoppingRule
    guard: Guard
    guidance: Guidance

    def iterate(self, env: Relay, estimate: ChannelEstimate) -> Iterator[IterationRecord]:
        """Learn; see `policy_iteration` for what is raised."""
        targets = mean_channel_targets(env.scenario, estimate.channel)
        cost = self.make_cost(estimate.channel, targets)
        self.lead = self.guidance(env, cost, targets)
        # One row a learner, as segments have them; hops are equal, so that one learner serves all vehicles.
        own = cost.of(torch.arange(self.learners, device=targets.neighbours.device))
        self.basis = self.make_basis(own)
        start = (self.start_gain * self.basis.start_weights()).repeat(self.learners, 1)
        # Weights are float64 whatever the environment's dtype.
        device = targets.neighbours.device
        actor = LinearActor(self.basis, start.to(device))
        critic = LinearCritic(self.basis, self.learners).to(device)
        self.start_weights = actor.weight.clone()
        hovering = self.basis.hovering(actor.weight)
        hover, trim = calibration_hover(env, hovering, cost, self.calibration_s, self.guard)
        if self.learners == 1:
            trim = trim.mean(0, keepdim=True)
        self.policy = LinkFramePolicy(targets.frame, actor, trim)
        operator = BellmanOperator(len(self.basis.critic_names), actor.sizes, cost.R, actor_sign=self.actor_sign)
        bounds = self.basis.bounds(self.inertia_lower, env.scenario.dt)
        solver = self.make_solver(operator, actor.weight, Bounds(bounds.lower.to(device), bounds.upper.to(device)))
        self.recorder = Recorder(self.basis, operator, own, trim, self.window, self.residual_floor)
        self.recorder.watch(env, hover)
        flight = self.experience.fly(env, hover, actor, self.recorder, self.guard)
        iterations = policy_iteration(
            flight, solver, actor, critic, self.updates, self.stopping, seconds=self.calibration_s
        )
        try:
            with torch.no_grad():
                yield from iterations
        except InsufficientDataError as error:
            raise InsufficientDataError(f"planner.max_time_s: {error}") from None
