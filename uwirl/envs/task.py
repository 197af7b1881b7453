"""The task for learners of other libraries, in many worlds at once: control steps, rewards, and ends of episodes."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.envs.features import Features
from uwirl.envs.starts import random_starts
from uwirl.study.evaluation import Evaluator
from uwirl.world.messages import link_snr_heard
from uwirl.world.random import RandomStreams
from uwirl.world.regions import separated
from uwirl.world.scenario import Scenario
from uwirl.world.trajectory import WorldState
from uwirl.world.vehicle import VehicleState


class TaskState(NamedTuple):
    """State of B episodes of M vehicles; all attributes except `world` are [B, M(, 2)].

    Attributes:
        world: vehicles and time.
        snr: last SNR readings of each vehicle's two links, [B, M, 2], dB; nan if it received nothing.
        stage: running cost without its control term, 1/s.
        cost: J so far.
        clearance: smallest distance so far from hull to an obstacle or another vehicle, m; infinite without these.
        touching: whether this distance is negative now.
        contacts: how often it has become negative, int64.
        blocked: whether there was no free route to the target at the start, bool.
    """

    world: WorldState
    snr: Tensor
    stage: Tensor
    cost: Tensor
    clearance: Tensor
    touching: Tensor
    contacts: Tensor
    blocked: Tensor

    def replaced(self, rows: Tensor, others: TaskState) -> TaskState:
        """A copy with other episodes in some worlds, by their indices [K]."""
        components = self.world.components.index_copy(1, rows, others.world.components)
        world = [a.index_copy(0, rows, b) for a, b in zip(self.world[1:], others.world[1:], strict=True)]
        rest = [a.index_copy(0, rows, b) for a, b in zip(self[1:], others[1:], strict=True)]
        return TaskState(WorldState(components, *world), *rest)


class Outcome(NamedTuple):
    """Result of one control step.

    Attributes:
        reward: of each vehicle, [B, M], float64.
        terminated: whether the episode has ended by a contact, bool [B].
        truncated: whether its time is over, bool [B].
    """

    reward: Tensor
    terminated: Tensor
    truncated: Tensor


class _Flown(NamedTuple):
    """Several steps of the world that form one control step.

    Attributes:
        world: state after it.
        effort: cost of control, [B, M].
        gap: distance from hull to the nearest obstacle or vehicle after each step, [hold, B, M], m.
        sent_from: positions at which the last message was sent, [B, M, 3], m.
    """

    world: WorldState
    effort: Tensor
    gap: Tensor
    sent_from: Tensor


class RelayTask:
    """The task to form a chain between two nodes at minimal cost.

    The reward is the negative running cost (37) on the true mean channel, integrated over a control step: terms that
    depend on the position by the trapezoid rule, the control term exactly. With a control period of scenario.dt the
    rewards of an episode sum to -J of `uwirl.study.evaluation`.

    Args:
        evaluator: worlds, running cost and guard; scenario, vehicle and channel are taken from its worlds, whose start,
            obstacles and mean current are the same for all.
        control_period_s: time for which an action is held, s; the guard is applied at every step of the world.
        nearest_obstacles: number of observed obstacles.
        random_start: whether every episode begins at random poses (`uwirl.envs.starts`).
        ends_on_contact: whether an episode ends for all vehicles when one touches an obstacle or another vehicle.

    Raises:
        ValueError: the control period is not a multiple of scenario.dt, or the worlds are not alike.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        *,
        control_period_s: float = 0.5,
        nearest_obstacles: int = 3,
        random_start: bool = False,
        ends_on_contact: bool = False,
    ):
        scenario = evaluator.env.scenario
        if scenario.start.ndim > 2 or scenario.obstacles.radius.ndim > 1 or scenario.current.mean.ndim > 1:
            raise ValueError("the worlds of a task share start, obstacles and mean current; these have their own")
        self.hold = round(control_period_s / scenario.dt)
        if self.hold < 1 or not math.isclose(self.hold * scenario.dt, control_period_s, rel_tol=1e-9):
            raise ValueError(f"control_period_s: must be a multiple of dt, {scenario.dt} s, got {control_period_s}")
        if nearest_obstacles < 0:
            raise ValueError(f"nearest_obstacles: must not be negative, got {nearest_obstacles}")
        self.evaluator = evaluator
        self.random_start, self.ends_on_contact = random_start, ends_on_contact
        around = scenario.obstacles
        cylinders = torch.cat([around.centre, around.velocity, (around.radius + scenario.vehicle_radius)[:, None]], -1)
        self._cylinders: list[list[Any]] = cylinders[around.present].tolist()
        self._pairs = list(combinations(range(scenario.vehicles), 2))
        self.features = Features(scenario, evaluator.mission.targets.frame, nearest_obstacles)

    @property
    def scenario(self) -> Scenario:
        """Of the worlds."""
        return self.evaluator.env.scenario

    @property
    def steps(self) -> int:
        """Number of control steps in an episode: the mission's duration, rounded up."""
        return math.ceil(self.scenario.steps / self.hold)

    def worlds(self, streams: RandomStreams) -> Evaluator:
        """The worlds with these random numbers, and their evaluator."""
        return self.evaluator.in_worlds(self.evaluator.env.on(self.scenario, streams))

    def begin(self, judge: Evaluator) -> TaskState:
        """Begin episodes; the first message is received at the start."""
        env, targets = judge.env, self.features.frame.target
        B, M = env.worlds, self.scenario.vehicles
        eta = self.scenario.start.expand(B, M, 4)
        if self.random_start:
            eta = random_starts(self.scenario, targets, env.streams)
        start = WorldState.of(VehicleState.from_eta_nu(eta))
        world = start._replace(target=targets.expand(B, M, 3).clone())
        gap = self._gap(world)
        around = self.scenario.obstacles
        return TaskState(
            world=world,
            snr=link_snr_heard(self.scenario, judge.truth, env.streams, world.vehicles.position, world.step),
            stage=self._stage_cost(judge, world),
            cost=gap.new_zeros(B, M, dtype=torch.float64),
            clearance=gap,
            touching=gap < 0.0,
            contacts=(gap < 0.0).long(),
            blocked=separated(around, self.scenario.vehicle_radius, eta[..., :2], targets[:, :2].expand(B, M, 2)),
        )

    def step(self, judge: Evaluator, state: TaskState, action: Tensor) -> tuple[TaskState, Outcome]:
        """Make one control step.

        Args:
            judge: evaluator of the worlds.
            state: state of their episodes.
            action: tau / tau_max, [B, M, 4]; larger values than 1 are limited by the vehicle.

        Raises:
            FloatingPointError: the vehicles' dynamics diverged.
        """
        flown = self._fly(judge, state, action * judge.env.vehicle.tau_max)
        stage = self._stage_cost(judge, flown.world)
        held = self.hold * self.scenario.dt
        cost = (0.5 * held * (state.stage + stage) + flown.effort).double()
        if not bool(cost.isfinite().all()):
            raise FloatingPointError(f"the dynamics diverged in world {int((~cost.isfinite()).nonzero()[0, 0])}")
        clearance, touching = flown.gap.amin(0), torch.cat([state.touching[None], flown.gap < 0.0])
        after = TaskState(
            world=flown.world,
            snr=self._heard(judge, state, flown.sent_from),
            stage=stage,
            cost=state.cost + cost,
            clearance=torch.minimum(state.clearance, clearance),
            touching=touching[-1],
            contacts=state.contacts + (touching[1:] & ~touching[:-1]).sum(0),
            blocked=state.blocked,
        )
        terminated = (clearance < 0.0).any(-1) & self.ends_on_contact
        return after, Outcome(-cost, terminated, flown.world.step >= self.scenario.steps)

    def _fly(self, judge: Evaluator, state: TaskState, command: Tensor) -> _Flown:
        """Hold a wanted tau [B, M, 4] for one control step, changed by the guard if needed."""
        env, cost, world = judge.env, judge.mission.cost, state.world
        observation, last, sent_at = env.observe(world), None, self._sent_at(world.step)
        first, final = int(sent_at.min()), int(sent_at.max())
        sent_from, effort, gaps = world.vehicles.position, torch.zeros_like(state.stage), []
        for k in range(1, self.hold + 1):
            wanted = judge.guard(command, observation)
            # Without a guard, `wanted` is always the same tensor and is processed only once.
            if wanted is not last:
                last, tau = wanted, env.vehicle.saturate(wanted)
                price = cost.control(tau - env.vehicle.trim) * self.scenario.dt
            effort += price
            world, observation = env.step(world, tau)
            gaps.append(self._gap(world))
            if first <= k <= final:
                sent_from = torch.where((sent_at == k)[:, None, None], world.vehicles.position, sent_from)
        return _Flown(world, effort, torch.stack(gaps), sent_from)

    def observe(self, judge: Evaluator, state: TaskState) -> Tensor:
        """The observations of the vehicles, [B, M, F], float32."""
        return self.features(judge.env.observe(state.world), state.snr)

    def _stage_cost(self, judge: Evaluator, world: WorldState) -> Tensor:
        """(37) without its control term, [B, M]."""
        cost, vehicles = judge.mission.cost, world.vehicles
        # A contiguous copy, for which norms along the last axis are several times faster.
        position, time = vehicles.position.contiguous(), world.step.double() * self.scenario.dt
        around = cost.obstacle(self.scenario.obstacles, position, time)
        return cost.state(self.features.frame.relative(vehicles)) + around

    def _sent_at(self, step: Tensor) -> Tensor:
        """Number of steps from `step` [B] to the last message in a control step; not positive if there is none."""
        every = round(self.scenario.message_period / self.scenario.dt)
        return (step + self.hold) // every * every - step

    def _heard(self, judge: Evaluator, state: TaskState, sent_from: Tensor) -> Tensor:
        """The last SNR readings after a control step, [B, M, 2], dB, for a message sent from [B, M, 3]."""
        sent_at = self._sent_at(state.world.step)
        if int(sent_at.max()) < 1:
            return state.snr
        message = (state.world.step + sent_at) // round(self.scenario.message_period / self.scenario.dt)
        snr = link_snr_heard(self.scenario, judge.truth, judge.env.streams, sent_from, message)
        return torch.where((sent_at > 0)[:, None, None] & ~snr.isnan(), snr, state.snr)

    def _gap(self, world: WorldState) -> Tensor:
        """Distance from each vehicle's hull to the nearest obstacle or vehicle, [B, M], m.

        Computed component by component, because a norm over an axis of two would take longer than the world step.
        """
        x, y, z = world.components[:3]
        gap, radius = torch.full_like(x, torch.inf), self.scenario.vehicle_radius
        for at_x, at_y, u, v, reach in self._cylinders:
            if u or v:
                time = (world.step.double() * self.scenario.dt).to(x.dtype)[:, None]
                at_x, at_y = at_x + u * time, at_y + v * time
            gap = torch.minimum(gap, torch.hypot(x - at_x, y - at_y) - reach)
        for i, j in self._pairs:
            away = torch.hypot(torch.hypot(x[:, i] - x[:, j], y[:, i] - y[:, j]), z[:, i] - z[:, j]) - 2.0 * radius
            for vehicle in (i, j):
                gap[:, vehicle] = torch.minimum(gap[:, vehicle], away)
        return gap
