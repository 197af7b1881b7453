"""Planners: from an estimated channel to a policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.networks import LinearActor, LinearCritic
from uwirl.irl.policy_iteration import InsufficientDataError, IterationRecord, StoppingRule, policy_iteration
from uwirl.irl.solvers import Bounds, Experience, Solver
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import RelayCost
from uwirl.motion.experience import FlightState, Leg, Recorder, Window
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


@dataclass(frozen=True)
class LearnerState:
    """What a learner knows when a leg of its flight is over: enough to go on as if never interrupted, bitwise.

    Attributes:
        record: the newest, which closed the leg.
        flight: where the flight stands.
        solver: its `state_dict`.
        trim: [L, 4].
        start_weights: what learning started from, [L, n3].
        contacts: counted while learning.
    """

    record: IterationRecord
    flight: FlightState
    solver: dict[str, Any]
    trim: Tensor
    start_weights: Tensor
    contacts: int


class LearningPlanner(ABC):
    """A planner whose fit proceeds in iterations worth watching.

    Attributes:
        policy: the newest policy.
        lead: leads it to the mission's target.
        basis: its features.
        start_weights: what it started from, [L, n3].
        recorder: has counted the contacts while learning.
        state: what it knew when the newest leg was over; set before the record that closes the leg is handed out.
    """

    policy: LinkFramePolicy
    lead: Lead
    basis: MotionBasis
    start_weights: Tensor
    recorder: Recorder
    state: LearnerState

    @abstractmethod
    def iterate(
        self, env: Relay, estimate: ChannelEstimate, resume: LearnerState | None = None
    ) -> Iterator[IterationRecord]:
        """Learn, one record an iteration; from the beginning, or on from a state."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Policy:
        """Learn to the end."""
        for _ in self.iterate(env, estimate):
            pass
        return self.lead(self.policy)


class ExperienceSource(Protocol):
    """Flies the newest policy and yields what it learned from."""

    def begin(self, hover: Trajectory) -> FlightState:
        """Where the flight stands when the calibration hover is over."""
        ...

    def fly(
        self, env: Relay, flight: FlightState, actor: LinearActor, recorder: Recorder, guard: Guard
    ) -> Iterator[Leg]:
        """Legs from where a flight stands; each depends on that and the actor's weights alone."""
        ...


CostFactory = Callable[[Channel, ChainTargets], RelayCost]
# From a basis and the number of learners to weights [L, n3] that were learned before.
GivenWeights = Callable[[MotionBasis, int], Tensor]


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
        given: weights to start from; None for those of the basis, times start_gain.
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
    given: GivenWeights | None = None

    def iterate(
        self, env: Relay, estimate: ChannelEstimate, resume: LearnerState | None = None
    ) -> Iterator[IterationRecord]:
        """Learn; see `policy_iteration` for what is raised."""
        cost, own, targets = self._problem(env, estimate)
        device = targets.neighbours.device
        start = self._start_weights() if resume is None else resume.start_weights
        # Weights are float64 whatever the environment's dtype.
        actor = LinearActor(self.basis, start.to(device, copy=True))
        critic = LinearCritic(self.basis, self.learners).to(device)
        self.start_weights = actor.weight.clone()
        if resume is None:
            hover, trim = calibration_hover(
                env, self.basis.hovering(actor.weight), cost, self.calibration_s, self.guard
            )
            if self.learners == 1:
                trim = trim.mean(0, keepdim=True)
        else:
            trim = resume.trim
        self.policy = LinkFramePolicy(targets.frame, actor, trim)
        operator = BellmanOperator(len(self.basis.critic_names), actor.sizes, cost.R, actor_sign=self.actor_sign)
        bounds = self.basis.bounds(self.inertia_lower, env.scenario.dt)
        solver = self.make_solver(operator, actor.weight, Bounds(bounds.lower.to(device), bounds.upper.to(device)))
        self.recorder = Recorder(self.basis, operator, own, trim, self.window, self.residual_floor)
        if resume is None:
            self.recorder.watch(env, hover)
            flight, after = self.experience.begin(hover), None
        else:
            self.state = resume
            solver.load_state_dict(resume.solver)
            self.recorder.contacts = resume.contacts
            flight, after = resume.flight, resume.record
        yield from self._learn(env, flight, after, solver, actor, critic)

    def _learn(
        self,
        env: Relay,
        flight: FlightState,
        after: IterationRecord | None,
        solver: Solver,
        actor: LinearActor,
        critic: LinearCritic,
    ) -> Iterator[IterationRecord]:
        """Fly and learn from there, keeping `state` up to date."""

        def experience() -> Iterator[Experience]:
            nonlocal flight
            for leg in self.experience.fly(env, flight, actor, self.recorder, self.guard):
                flight = leg.after
                yield leg.experience

        iterations = policy_iteration(
            experience(), solver, actor, critic, self.updates, self.stopping, self.calibration_s, after
        )
        try:
            with torch.no_grad():
                for record in iterations:
                    if record.closes:
                        learned = solver.state_dict()
                        contacts = self.recorder.contacts
                        self.state = LearnerState(
                            record, flight, learned, self.policy.trim, self.start_weights, contacts
                        )
                    yield record
        except InsufficientDataError as error:
            raise InsufficientDataError(f"planner.max_time_s: {error}") from None

    def adopt(self, env: Relay, estimate: ChannelEstimate, weights: GivenWeights, trim: Tensor) -> Policy:
        """A policy that was learned before, without learning.

        Args:
            env: the worlds it shall serve.
            estimate: their channel.
            weights: of the policy.
            trim: tau that holds a vehicle at rest, [1 or L, 4].
        """
        _, _, targets = self._problem(env, estimate)
        weight = weights(self.basis, self.learners).to(targets.neighbours.device)
        self.policy = LinkFramePolicy(targets.frame, LinearActor(self.basis, weight), trim)
        return self.lead(self.policy)

    def _problem(self, env: Relay, estimate: ChannelEstimate) -> tuple[RelayCost, RelayCost, ChainTargets]:
        """The cost of the vehicles and that of the learners, and where the vehicles should be; sets lead and basis."""
        targets = mean_channel_targets(env.scenario, estimate.channel)
        cost = self.make_cost(estimate.channel, targets)
        self.lead = self.guidance(env, cost, targets)
        # One row a learner, as segments have them; hops are equal, so that one learner serves all vehicles.
        own = cost.of(torch.arange(self.learners, device=targets.neighbours.device))
        self.basis = self.make_basis(own)
        return cost, own, targets

    def _start_weights(self) -> Tensor:
        """[L, n3]."""
        if self.given is not None:
            return self.given(self.basis, self.learners)
        return (self.start_gain * self.basis.start_weights()).repeat(self.learners, 1)
