"""The relay environment: batched worlds in which vehicles move and links carry data (Fig. 1)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.agent import Agent, check_shape, decide
from uwirl.world.messages import Messages, snr_heard, told_to_all
from uwirl.world.observation import Observation
from uwirl.world.obstacles import Obstacles
from uwirl.world.random import RandomStreams
from uwirl.world.scenario import Scenario
from uwirl.world.trajectory import Trajectory, WorldState, at_rest
from uwirl.world.truth import Truth
from uwirl.world.vehicle import Dynamics, Vehicle


class Relay:
    """B independent worlds of one scenario.

    Args:
        scenario: nodes, vehicles, sensors, time.
        vehicle: dynamics of every vehicle; a BlueROV2 if None.
        channel: the true channel; vehicles only get readings of it (`uwirl.world.truth`). The paper's if None.
        streams: random numbers of B worlds; one world of seed 0 if None.
        compiled: whether PyTorch compiles its step, to results that differ by rounding.
    """

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Dynamics | None = None,
        channel: Channel | None = None,
        streams: RandomStreams | None = None,
        compiled: bool = False,
    ):
        self.scenario = scenario
        self.vehicle: Dynamics = Vehicle.bluerov2() if vehicle is None else vehicle
        self.streams = streams or RandomStreams.worlds(0, 1, scenario.source.device)
        self._truth = Truth(channel or Channel.paper(), scenario.source, scenario.destination, self.streams)
        self._map: tuple[Obstacles, Obstacles] | None = None
        self._water = None if scenario.current.is_still else scenario.current.realise(self.streams)
        self.compiled = compiled
        if compiled:
            self._advance, self.observe = torch.compile(self._advance), torch.compile(self.observe)  # type: ignore[method-assign]

    @property
    def worlds(self) -> int:
        """Number of worlds B."""
        return len(self.streams.seed)

    @property
    def budget(self) -> LinkBudget:
        """What is known about the links beforehand."""
        return self._truth.channel.budget

    def on(self, scenario: Scenario, streams: RandomStreams) -> Relay:
        """The same vehicles and channel with another scenario and other random numbers."""
        return Relay(scenario, self.vehicle, self._truth.channel, streams, self.compiled)

    def select(self, index: Tensor) -> Relay:
        """The environment of some worlds, by their indices [K] in the batch."""
        return self.on(self.scenario.worlds(index), self.streams.select(index))

    def start(self) -> WorldState:
        """The state of all worlds at the scenario's start, at rest."""
        start = self.scenario.start
        return at_rest(start.expand(self.worlds, *start.shape[-2:]))

    def reset(self) -> tuple[WorldState, Observation]:
        """The state at the scenario's start, at rest, and the vehicles' observation there."""
        state = self.start()
        return state, self.observe(state)

    def step(self, state: WorldState, tau: Tensor, target: Tensor | None = None) -> tuple[WorldState, Observation]:
        """One step of scenario.dt.

        Args:
            state: of B worlds, not modified; B is arbitrary if the environment has one world.
            tau: [B, M, 4], saturated here and held over the step.
            target: targets that the vehicles announce, [B, M, 3], m; None keeps those announced before.

        Raises:
            ValueError: tau or target is not a floating-point tensor of that shape, or the state has another B.
        """
        self._check_worlds(state)
        check_shape("tau", tau, state.vehicles.eta.shape)
        components = torch.empty_like(state.components)
        self._advance(state, self.vehicle.saturate(tau), components)
        after = WorldState(components, state.step + 1, _said(target, state.target))
        return after, self.observe(after)

    def observe(self, state: WorldState) -> Observation:
        """The vehicles' observation at a state; a pure function of the state."""
        scenario = self.scenario
        x, step = state.components, state.step
        eta, nu = x[:4].movedim(0, -1), x[4:].movedim(0, -1)
        # `step` limits z to [-depth, 0]; truncated to an integer, this is 1 or -1 only at the ends of that range.
        middle = 0.5 * scenario.depth
        contact = x[2].add(middle).div_(middle).to(torch.int8)
        if not scenario.navigation.is_exact:
            error = scenario.navigation.error(self.streams, step, scenario.dt, x.shape[2]).to(x.dtype)
            eta, nu = eta + error[..., :4], nu + error[..., 4:]
        obstacles = self._detected(x, step)
        return Observation(step, scenario.dt, eta, nu, obstacles, contact, self._messages(state, eta, nu))

    def rollout(
        self, agent: Agent, state: WorldState | None = None, steps: int | None = None, carry: Any = None
    ) -> Trajectory:
        """Fly an agent: call `step` in a loop and write one trajectory.

        Args:
            agent: chooses tau at every step.
            state: initial state, all worlds at the same step; the scenario's start if None. Its number of worlds is
                arbitrary if the environment has one world.
            steps: number of integration steps; those of a mission if None.
            carry: the agent's memory, to continue a flight; None begins one.

        Raises:
            ValueError: the agent did not return a pair of tau [B, M, 4] and a carry, or announces a target of another
                shape; or the state's worlds are at different steps, or do not fit the environment.
            DivergedError: a state or control stopped being finite; the message names the step and the quantity.
        """
        state = self.start() if state is None else state
        self._check_worlds(state)
        steps = self.scenario.steps if steps is None else steps
        first_step, last_step = int(state.step.min()), int(state.step.max())
        if first_step != last_step:
            raise ValueError(f"worlds at different steps, {first_step} to {last_step}, make no one trajectory")
        x = state.components
        components = x.new_empty(steps + 1, *x.shape)
        tau = x.new_empty(steps, 4, *x.shape[1:])
        components[0] = x
        observation = self.observe(state)
        carry = agent.init(observation) if carry is None else carry
        for k in range(steps):
            wanted, carry = decide(agent, carry, observation)
            after = components[k + 1]
            command = self.vehicle.saturate(wanted)
            self._advance(state, command, after)
            state = WorldState(after, state.step + 1, _said(getattr(carry, "target", None), state.target))
            tau[k] = command.movedim(-1, 0)
            if k + 1 < steps:
                observation = self.observe(state)
        trajectory = Trajectory(components, tau.movedim(1, -1), self.scenario.dt, first_step, state, carry)
        trajectory.check_finite()
        return trajectory

    def _check_worlds(self, state: WorldState) -> None:
        B = state.components.shape[1]
        if self.worlds not in (1, B):
            raise ValueError(f"state of {B} worlds in an environment of {self.worlds}")

    def _advance(self, state: WorldState, command: Tensor, out: Tensor) -> None:
        """The components after one step, written into `out` [8, B, M]."""
        scenario = self.scenario
        water = None if self._water is None else self._water(state.step.double() * scenario.dt).to(out.dtype)
        self.vehicle.step(state.vehicles, command, scenario.dt, water, out=out)
        # The surface and the floor stop a vehicle's centre.
        z, w = out[2], out[6]
        inside = z.clamp(-scenario.depth, 0.0)
        w.masked_fill_(w * z.sub(inside) > 0.0, 0.0)
        z.copy_(inside)

    def _detected(self, x: Tensor, step: Tensor) -> Obstacles:
        """Obstacles that each vehicle detects at its position, fields [B, M, O(, 2)]."""
        scenario, (B, M) = self.scenario, x.shape[1:]
        everywhere = scenario.obstacles
        # This view is the same at every step, so it is made only once.
        if self._map is None or self._map[0] is not everywhere or self._map[1].radius.shape[:2] != (B, M):
            self._map = everywhere, _for_each_vehicle(everywhere, B, M)
        known = self._map[1]
        if scenario.detection_range == torch.inf or everywhere.number == 0:
            return known
        time = step.double() * scenario.dt
        gap = everywhere.clearance(x[:3].movedim(0, -1), scenario.vehicle_radius, time)
        detected = known.present & (gap <= scenario.detection_range)
        hidden = known.each(lambda field: torch.where(_like(detected, field), field, torch.zeros_like(field)))
        return hidden._replace(present=detected)

    def _messages(self, state: WorldState, eta: Tensor, nu: Tensor) -> Messages:
        snr = self._snr(state) if self.scenario.streaming else _nothing_heard(eta)
        return Messages(told_to_all(eta), told_to_all(nu), told_to_all(state.target), snr)

    def _snr(self, state: WorldState) -> Tensor:
        """Readings of this step's messages, [B, M, 3, N], or [B, M, 3, 0] where no world sends one."""
        scenario, M = self.scenario, self.scenario.vehicles
        every = round(scenario.message_period / scenario.dt)
        sends = state.step % every == 0
        if not bool(sends.any()):
            return _nothing_heard(state.target)
        position, number = state.vehicles.position, state.step // every
        heard = [snr_heard(scenario, self._truth, self.streams, position[:, i], i, number) for i in range(M)]
        return torch.where(sends[:, None, None, None], torch.stack(heard, 1), torch.nan)


def _said(target: Tensor | None, before: Tensor) -> Tensor:
    """Announced targets [B, M, 3]: the new ones, or those announced before if there are none."""
    if target is None:
        return before
    check_shape("target", target, before.shape)
    return target.to(before.dtype)


def _for_each_vehicle(everywhere: Obstacles, worlds: int, vehicles: int) -> Obstacles:
    """Obstacles [O(, 2)] or [B, O(, 2)] as a view for each vehicle of each world, [B, M, O(, 2)]."""
    shared = everywhere.radius.ndim == 1

    def view(field: Tensor) -> Tensor:
        trailing = field.shape if shared else field.shape[1:]
        return (field if shared else field[:, None]).expand(worlds, vehicles, *trailing)

    return everywhere.each(view)


def _nothing_heard(like: Tensor) -> Tensor:
    """Empty readings [B, M, 3, 0], with dtype and device of values [B, M, k]."""
    return like.new_empty((*like.shape[:2], 3, 0), dtype=torch.float64)


def _like(mask: Tensor, field: Tensor) -> Tensor:
    """A mask [B, M, O], expanded to select in a field [B, M, O(, 2)]."""
    return mask if field.ndim == mask.ndim else mask[..., None]
