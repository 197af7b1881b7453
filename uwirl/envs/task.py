"""What learners from elsewhere are to do in many worlds at once: a step of control, its cost, and when it is over."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.envs.features import Features
from uwirl.envs.starts import random_starts
from uwirl.study.evaluation import Evaluator
from uwirl.world.messages import link_snr_heard
from uwirl.world.random import RandomStreams
from uwirl.world.regions import separated
from uwirl.world.relay import WorldState
from uwirl.world.scenario import Scenario
from uwirl.world.vehicle import VehicleState


class TaskState(NamedTuple):
    """Where B episodes of M vehicles stand; all but `world` is [B, M(, 2)].

    Attributes:
        world: vehicles and time.
        snr: what each vehicle has read last of its links to either side, [B, M, 2], dB; nan where it heard nothing.
        stage: what a second here costs, control aside.
        cost: J so far.
        clearance: the smallest so far from hull to obstacle or to another vehicle, m; infinite where there is neither.
        touching: whether it is negative now.
        contacts: how often it turned negative, int64.
        blocked: whether no way led to the target at the start, bool.
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
        """With other episodes in some of the worlds, by their places [K]."""
        components = self.world.components.index_copy(1, rows, others.world.components)
        world = [a.index_copy(0, rows, b) for a, b in zip(self.world[1:], others.world[1:], strict=True)]
        rest = [a.index_copy(0, rows, b) for a, b in zip(self[1:], others[1:], strict=True)]
        return TaskState(WorldState(components, *world), *rest)


class Outcome(NamedTuple):
    """What one step of control brought.

    Attributes:
        reward: of each vehicle, [B, M], float64.
        terminated: whether a contact has ended the episode, bool [B].
        truncated: whether its time is over, bool [B].
    """

    reward: Tensor
    terminated: Tensor
    truncated: Tensor


class RelayTask:
    """Vehicles that are to form a chain between two nodes at least cost.

    The reward is minus the running cost (37) of the true mean channel, integrated over a step of control: its terms of
    place by the trapezoid rule from one step to the next, that of control exactly. With a control period of scenario.dt
    the rewards of an episode add up to -J of `uwirl.study.evaluation`.

    Args:
        evaluator: worlds, running cost and guard; scenario, vehicle and channel are taken from its worlds, whose start,
            obstacles and mean current are the same for all.
        control_period_s: for which an action is held; the guard acts at every step of the world.
        nearest_obstacles: how many are observed.
        random_start: whether every episode begins elsewhere (`uwirl.envs.starts`).
        ends_on_contact: whether an episode ends, for all its vehicles, when one touches an obstacle or another.

    Raises:
        ValueError: the control period is no multiple of scenario.dt, or the worlds are not alike.
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
        self.features = Features(scenario, evaluator.mission.targets.frame, nearest_obstacles)

    @property
    def scenario(self) -> Scenario:
        return self.evaluator.env.scenario

    @property
    def steps(self) -> int:
        """Steps of control in an episode: as many as the mission needs, the last one whole."""
        return math.ceil(self.scenario.steps / self.hold)

    def worlds(self, streams: RandomStreams) -> Evaluator:
        """Those of these random numbers, and the judge of what happens in them."""
        return self.evaluator.in_worlds(self.evaluator.env.on(self.scenario, streams))

    def begin(self, judge: Evaluator) -> TaskState:
        """Episodes at their start, where the first message is heard."""
        env, targets = judge.env, self.features.frame.target
        B, M = env.worlds, self.scenario.vehicles
        eta = self.scenario.start.expand(B, M, 4)
        if self.random_start:
            eta = random_starts(self.scenario, targets, env.streams)
        start = WorldState.of(VehicleState.from_eta_nu(eta))
        world = start._replace(target=targets.expand(B, M, 3).clone())
        gap = self._gap(world.components[None], world.step[None])[0]
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
        """One step of control.

        Args:
            judge: of the worlds.
            state: of their episodes.
            action: tau as a share of tau_max, [B, M, 4]; the vehicle's limits hold beyond 1.

        Raises:
            FloatingPointError: the vehicles' dynamics diverged.
        """
        env, world, observation = judge.env, state.world, judge.env.observe(state.world)
        command = action * env.vehicle.tau_max
        path, last, effort = [], None, torch.zeros_like(state.stage)
        for _ in range(self.hold):
            wanted = judge.guard(command, observation)
            # No guard returns the command itself, which need not be looked at again.
            if wanted is not last:
                last, tau = wanted, env.vehicle.saturate(wanted)
                price = judge.mission.cost.control(tau - env.vehicle.trim) * self.scenario.dt
            effort = effort + price
            world, observation = env.step(world, tau)
            path.append(world)
        stage = self._stage_cost(judge, world)
        cost = (0.5 * self.hold * self.scenario.dt * (state.stage + stage) + effort).double()
        if not bool(cost.isfinite().all()):
            raise FloatingPointError(f"the dynamics diverged in world {int((~cost.isfinite()).nonzero()[0, 0])}")
        steps, components = torch.stack([w.step for w in path]), torch.stack([w.components[:3] for w in path])
        gap = self._gap(components, steps)
        touching = torch.cat([state.touching[None], gap < 0.0])
        after = TaskState(
            world=world,
            snr=self._heard(judge, state, components, steps),
            stage=stage,
            cost=state.cost + cost,
            clearance=torch.minimum(state.clearance, gap.amin(0)),
            touching=touching[-1],
            contacts=state.contacts + (touching[1:] & ~touching[:-1]).sum(0),
            blocked=state.blocked,
        )
        terminated = touching[1:].flatten(2).any(-1).any(0) & self.ends_on_contact
        return after, Outcome(-cost, terminated, world.step >= self.scenario.steps)

    def observe(self, judge: Evaluator, state: TaskState) -> Tensor:
        """What the vehicles are told, [B, M, F], float32."""
        return self.features(judge.env.observe(state.world), state.snr)

    def _stage_cost(self, judge: Evaluator, world: WorldState) -> Tensor:
        """(37) without its control term, [B, M]."""
        cost, vehicles = judge.mission.cost, world.vehicles
        around = cost.obstacle(self.scenario.obstacles, vehicles.position, world.step.double() * self.scenario.dt)
        return cost.state(self.features.frame.relative(vehicles)) + around

    def _heard(self, judge: Evaluator, state: TaskState, path: Tensor, steps: Tensor) -> Tensor:
        """The last SNR readings after a path [hold, 3, B, M] that passes some steps [hold, B], [B, M, 2], dB."""
        every = round(self.scenario.message_period / self.scenario.dt)
        message = steps[-1] // every
        ago = steps[-1] - message * every
        fresh = ago < self.hold
        if not bool(fresh.any()):
            return state.snr
        worlds = torch.arange(len(ago), device=ago.device)
        sent_from = path[(self.hold - 1 - ago).clamp_min(0), :, worlds].mT
        snr = link_snr_heard(self.scenario, judge.truth, judge.env.streams, sent_from, message)
        return torch.where(fresh[:, None, None] & ~snr.isnan(), snr, state.snr)

    def _gap(self, path: Tensor, steps: Tensor) -> Tensor:
        """From each vehicle's hull to the nearest obstacle or vehicle, [n, B, M], m, on paths [n, 3 or more, B, M].

        Components first, because a norm over an axis of two would take longer than the world itself.
        """
        x, y, z = path[:, 0], path[:, 1], path[:, 2]
        radius, obstacles = self.scenario.vehicle_radius, self.scenario.obstacles
        gap = torch.full_like(x, torch.inf)
        time = (steps.double() * self.scenario.dt).to(x.dtype)[..., None]
        for k in obstacles.present.nonzero()[:, 0].tolist():
            at = obstacles.centre[k] + obstacles.velocity[k] * time[..., None]
            distance = torch.hypot(x - at[..., 0], y - at[..., 1])
            gap = torch.minimum(gap, distance.sub_(obstacles.radius[k] + radius))
        for i, j in torch.combinations(torch.arange(x.shape[-1])).tolist():
            away = torch.hypot(torch.hypot(x[..., i] - x[..., j], y[..., i] - y[..., j]), z[..., i] - z[..., j])
            for vehicle in (i, j):
                gap[..., vehicle] = torch.minimum(gap[..., vehicle], away - 2.0 * radius)
        return gap
