"""Stage 2 as a learning process: a fixed problem, defined by the estimate, and a state that changes with each leg."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.networks import LinearActor, LinearCritic
from uwirl.irl.policy_iteration import InsufficientDataError, LearnerState, PolicyIteration
from uwirl.irl.solvers import Bounds
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cruise import declared_model
from uwirl.motion.experience import FlightState, Leg, Pilot, contacts_while
from uwirl.motion.features import MotionBasis
from uwirl.motion.identification import Identified, Log, Windows, identify_flights
from uwirl.motion.irl_settings import IrlSettings
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.mission import Mission
from uwirl.motion.recorder import Recorder, Window
from uwirl.motion.safety import EnergyGuard, Limits
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.relay import Relay

# Vehicle time until which a model that is flown already is identified more exactly, s.
REFINED_S = 60.0


class LearningState(NamedTuple):
    """State after a leg of the learning flight; enough to continue bitwise as without interruption.

    Attributes:
        flight: state of the flight.
        learner: state of the learner.
        trim: tau that holds a vehicle at rest, as measured, [L, 4].
        start: start weights, [L, n3].
        seconds: vehicle time so far, s.
        contacts: number of contacts with obstacles so far.
        logs: flights from which no model has been identified yet.
        known: the model of the vehicles, which are alike; None until one is identified.
    """

    flight: FlightState
    learner: LearnerState
    trim: Tensor
    start: Tensor
    seconds: float
    contacts: int
    logs: tuple[Log, ...] = ()
    known: Identified | None = None


@dataclass(frozen=True)
class IterationRecord:
    """One policy evaluation and improvement.

    Attributes:
        iteration: s, from 1.
        seconds: vehicle time used so far, s.
        critic: weights [L, n2].
        actor: weights of the improved policy, [L, n3].
        weight_change: relative change of the actor's weights, the largest over the learners.
        converged: whether the change is below epsilon_3.
        rows: rows of experience so far, for each learner.
        closes: whether this is the last iteration of its leg.
        residual, condition: see `uwirl.irl.solvers.Solution`, the largest over the learners; None if not known.
        modelled: whether a model of the vehicle has been identified by then.
    """

    iteration: int
    seconds: float
    critic: Tensor
    actor: Tensor
    weight_change: float
    converged: bool
    rows: int
    closes: bool
    residual: float | None = None
    condition: float | None = None
    modelled: bool = False


class Learning:
    """The second loop of Algorithm 1, one leg at a time.

    Args:
        planner: its settings.
        env: the worlds to fly in.
        estimate: the channel estimate to plan with.
    """

    def __init__(self, planner: IrlSettings, env: Relay, estimate: ChannelEstimate):
        self.planner, self.env = planner, env
        self.guard = planner.guard or EnergyGuard(Limits.of(env))
        self.mission = Mission(env, estimate.channel, planner.cost)
        self.learners = planner.experience.learners(env)
        # One row per learner, as in segments; all hops are equal, so one learner can be used for all vehicles.
        device = self.mission.targets.neighbours.device
        self.cost = self.mission.cost.of(torch.arange(self.learners, device=device))
        self.basis: MotionBasis = planner.basis(self.cost)
        sizes = [len(names) for names in self.basis.actor_names]
        self.operator = BellmanOperator(len(self.basis.critic_names), sizes, self.cost.R, actor_sign=planner.sign)
        bounds = self.basis.bounds(planner.inertia_lower, env.scenario.dt)
        solver = planner.solver(self.operator, Bounds(bounds.lower.to(device), bounds.upper.to(device)))
        self.iteration = PolicyIteration(solver, self.operator.unknowns, planner.updates, planner.tolerance_weights)

    def init(self, weights: Tensor | None = None) -> LearningState:
        """Hover, to measure the trim.

        Args:
            weights: start weights, [L, n3]; None for those of the basis, times start_gain.

        Raises:
            InadmissiblePolicyError: the cost grows with the start policy.
        """
        planner, device = self.planner, self.mission.targets.neighbours.device
        if weights is None:
            weights = (planner.start_gain * self.basis.start_weights()).repeat(self.learners, 1)
        # Weights are float64 whatever the environment's dtype.
        start = weights.to(device, copy=True)
        critic = LinearCritic(self.basis, self.learners).to(device)
        learner = self.iteration.init(start, critic.weight)
        if not planner.experience.hovers:
            flight, trim = planner.experience.begin(self.env.start()), start.new_zeros(self.learners, 4)
            return LearningState(flight, learner, trim, start, 0.0, 0)
        hovering = self.basis.hovering(start)
        hover, trim = calibration_hover(self.env, hovering, self.mission.cost, planner.calibration_s, self.guard)
        trim = trim.mean(0, keepdim=True) if self.learners == 1 else trim
        flight = planner.experience.begin(hover.end)
        seconds, contacts = float(hover.time[-1]), contacts_while(self.env, hover)
        return LearningState(flight, learner, trim, start, seconds, contacts, (Log.of(hover),))

    def step(self, state: LearningState) -> LearningState:
        """Fly a leg and learn from it."""
        leg, state = self.fly(state)
        return self.improve(state, leg)

    def fly(self, state: LearningState) -> tuple[Leg, LearningState]:
        """Fly the next leg with the newest weights; the returned state has not learned from it yet."""
        actor = LinearActor(self.basis, state.learner.actor)

        def pilot() -> Pilot:
            agent = self.agent(state.learner.actor, state.trim, known=state.known)
            return Pilot(agent, self.mission.targets.frame, state.known is None)

        leg = self.planner.experience.fly(self.env, state.flight, actor, self._recorder(state), self.guard, pilot)
        contacts, logs = state.contacts + leg.contacts, state.logs
        if self._identifies(state):
            logs = (*logs, Log.of(leg.flown))
            if not self.planner.experience.hovers and leg.flown.first_step % self.env.scenario.steps:
                # Windows may cross the legs of one mission.
                logs = (*logs[:-2], Log.joined(logs[-2:]))
        after = state._replace(flight=leg.after, seconds=state.seconds + leg.seconds, contacts=contacts, logs=logs)
        return leg, after

    def improve(self, state: LearningState, leg: Leg) -> LearningState:
        """Evaluate the policy with the experience of a leg and improve it, `updates` times.

        The same experience serves any policy, because learning is off-policy.
        """
        return self._modelled(state._replace(learner=self.iteration.update(state.learner, leg.batch)))

    def _modelled(self, state: LearningState) -> LearningState:
        """The state with a model, once the flight tells one."""
        planner, scenario = self.planner, self.env.scenario
        over = state.learner.settled or state.seconds >= min(planner.model_time_s, planner.max_time_s)
        if not (self._identifies(state) and over):
            return state
        steps = round(planner.model_window_s / scenario.dt)
        windows = Windows(planner.regressor, scenario.dt, steps, steps, scenario.depth)
        still = torch.zeros(2, dtype=torch.float64, device=state.trim.device)
        known = identify_flights(windows, list(state.logs), self.env.vehicle.tau_max, still)
        if known is None or known.doubtful_inertia(planner.regressor, planner.most_doubt):
            return state
        if planner.experience.hovers:
            return state._replace(known=known, logs=())
        trim = known.model(planner.regressor, state.trim.device).trim.expand_as(state.trim)
        return state._replace(known=known, trim=trim, logs=() if state.seconds >= REFINED_S else state.logs)

    def _identifies(self, state: LearningState) -> bool:
        """Whether a model is still to be found, or found more exactly."""
        return state.known is None or bool(state.logs)

    def is_over(self, state: LearningState) -> bool:
        """Whether the weights have settled, or the time is up.

        Raises:
            InsufficientDataError: the time is up, with fewer rows than unknowns.
        """
        late = state.flight.leg > 0 and state.seconds >= self.planner.max_time_s
        learner = state.learner
        if late and not learner.iteration:
            unknowns = self.operator.unknowns
            raise InsufficientDataError(
                f"planner.max_time_s: {learner.rows} rows of experience for {unknowns} unknown weights: fly longer"
            )
        # A mission is flown to its end.
        within = not self.planner.experience.hovers and int(state.flight.world.step[0]) % self.env.scenario.steps
        return late or (learner.settled and not within)

    def records(self, state: LearningState) -> list[IterationRecord]:
        """Records of the policy iterations after the newest leg."""
        learner = state.learner
        last = len(learner.iterates) - 1
        return [
            IterationRecord(
                iterate.iteration,
                state.seconds,
                iterate.critic,
                iterate.actor,
                iterate.change,
                learner.settled and k == last,
                learner.rows,
                k == last,
                iterate.residual,
                iterate.condition,
                state.known is not None,
            )
            for k, iterate in enumerate(learner.iterates)
        ]

    def agent(self, weights: Tensor, trim: Tensor, env: Relay | None = None, known: Identified | None = None) -> Agent:
        """The agent with given weights.

        Args:
            weights: actor weights, [L, n3].
            trim: tau that holds a vehicle at rest, [1 or L, 4].
            env: worlds to fly in, between the same nodes, with the same number of vehicles, or with any number if
                there is one set of weights; the worlds of learning if None.
            known: model by which it flies along routes; what is declared of the vehicle if None.
        """
        mission = self.mission if env is None else Mission(env, self.mission.channel, self.mission.weights)
        near = LinkController(mission.targets.frame, LinearActor(self.basis, weights), trim)
        tau_max = mission.env.vehicle.tau_max
        if known is None:
            model = declared_model(torch.tensor(list(self.planner.inertia_lower)), tau_max)
        else:
            model = known.model(self.planner.regressor, tau_max.device)
        return self.planner.guidance(mission)(near, model)

    def _recorder(self, state: LearningState) -> Recorder:
        planner, scenario = self.planner, self.env.scenario
        window = Window(round(planner.window_s / scenario.dt), round(planner.stride_s / scenario.dt))
        return Recorder(
            self.basis, self.operator, self.cost, state.trim, window, planner.residual_floor, scenario.depth
        )
