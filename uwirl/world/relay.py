"""The relay environment: batched worlds in which vehicles move and links carry data (Fig. 1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from uwirl.world.acoustics import Channel
from uwirl.world.fading import Shadowing, ShadowingField
from uwirl.world.random import RandomStreams
from uwirl.world.scenario import Scenario
from uwirl.world.vehicle import Dynamics, VehicleState


class DivergedError(RuntimeError):
    """A simulated quantity stopped being finite."""


@dataclass(frozen=True)
class Trajectory:
    """What a rollout leaves behind.

    Attributes:
        components: states at the n + 1 step boundaries, [n + 1, 8, B, M].
        tau: control held over each step, [n, B, M, 4].
        dt: s.
        first_step: step index, from the beginning of the flight, of the first state.
    """

    components: Tensor
    tau: Tensor
    dt: float
    first_step: int = 0

    @property
    def eta(self) -> Tensor:
        """[n + 1, B, M, 4], a view."""
        return self.components[:, :4].movedim(1, -1)

    @property
    def nu(self) -> Tensor:
        """[n + 1, B, M, 4], a view."""
        return self.components[:, 4:].movedim(1, -1)

    @property
    def states(self) -> VehicleState:
        """All states as one batch [n + 1, B, M]."""
        return VehicleState(self.components.movedim(0, 1))

    @property
    def last(self) -> VehicleState:
        return VehicleState(self.components[-1])

    @property
    def time(self) -> Tensor:
        """[n + 1], s."""
        n = self.components.shape[0]
        return (self.first_step + torch.arange(n, dtype=torch.float64, device=self.components.device)) * self.dt


class Relay:
    """B independent worlds of one scenario.

    Args:
        scenario: nodes, vehicles, sensors, time.
        vehicle: dynamics of every vehicle.
        channel: the true channel, which a learner sees only through readings.
        streams: the worlds' random numbers; their number is B.
    """

    def __init__(self, scenario: Scenario, vehicle: Dynamics, channel: Channel, streams: RandomStreams):
        self.scenario = scenario
        self.vehicle = vehicle
        self.channel = channel
        self.streams = streams

    @property
    def worlds(self) -> int:
        return len(self.streams.seed)

    @cached_property
    def shadowing(self) -> ShadowingField:
        """Of each world's links, from their ends [..., B, *, 3] in the order of the field."""
        return Shadowing(float(self.channel.zeta_dB), float(self.channel.varphi_m)).realise(self.streams)

    def reset(self) -> VehicleState:
        """All worlds at the scenario's start, at rest, [8, B, M] underneath."""
        start = self.scenario.start
        return VehicleState.from_eta_nu(start.expand(self.worlds, *start.shape[-2:]))

    def on(self, scenario: Scenario, streams: RandomStreams) -> Relay:
        """The same water and vehicles in other worlds."""
        return Relay(scenario, self.vehicle, self.channel, streams)

    def select(self, index: Tensor) -> Relay:
        """The environment of some of the worlds, by their places [K] in the batch."""
        return self.on(self.scenario.worlds(index), self.streams.select(index))

    def rollout(
        self, policy: Callable[[VehicleState, int], Tensor], state: VehicleState, steps: int, first_step: int = 0
    ) -> Trajectory:
        """Fly a policy from a state.

        Args:
            policy: (state, step index) -> tau [B, M, 4]; it is saturated here and held for one step.
            state: where to start; its batch may differ from the scenario's.
            steps: number of integration steps.
            first_step: index of the first of them: what drifts is where it is at that time.

        Raises:
            DivergedError: a state or control stopped being finite; the message names the step and the quantity.
        """
        current = self.scenario.current.realise(self.streams)
        x = state.components
        components = x.new_empty(steps + 1, *x.shape)
        tau = x.new_empty(steps, 4, *x.shape[1:])
        components[0] = x
        for k in range(steps):
            step = first_step + k
            command = self.vehicle.saturate(policy(state, step))
            water = None if self.scenario.current.is_still else current(step * self.scenario.dt).to(x.dtype)
            state = self.vehicle.step(state, command, self.scenario.dt, water, out=components[k + 1])
            self._confine(components[k + 1])
            tau[k] = command.movedim(-1, 0)
        trajectory = Trajectory(components, tau.movedim(1, -1), self.scenario.dt, first_step)
        self._check_finite(trajectory)
        return trajectory

    def _confine(self, x: Tensor) -> None:
        """Surface and floor stop a vehicle's centre, in place."""
        z, w = x[2], x[6]
        inside = z.clamp(-self.scenario.depth, 0.0)
        w.masked_fill_((inside != z) & (w * z.sub(inside) > 0.0), 0.0)
        z.copy_(inside)

    @staticmethod
    def _check_finite(trajectory: Trajectory) -> None:
        for name in ("tau", "nu", "eta"):
            finite = torch.isfinite(getattr(trajectory, name)).flatten(1).all(1)
            if not bool(finite.all()):
                step = int((~finite).nonzero()[0])
                raise DivergedError(
                    f"{name} is not finite at step {step} (t = {float(trajectory.time[step]):g} s of the flight)"
                )

    def chain(self, position: Tensor) -> Tensor:
        """Nodes of the communication chain in order, source first, [..., M + 2, 3], of vehicles at [..., M, 3]."""
        shape = (*position.shape[:-2], 1, 3)
        ends = self.scenario.source.expand(shape), self.scenario.destination.expand(shape)
        return torch.cat([ends[0], position, ends[1]], -2)

    def link_capacities_kbps(self, position: Tensor, shadowed: bool = False) -> Tensor:
        """Capacity of each link, [..., M + 1], of vehicles at [..., M, 3]; the chain's is their minimum (5).

        Args:
            position: [..., M, 3], or [..., B, M, 3] where shadowed, m.
            shadowed: whether of path loss and shadowing, or of path loss alone, the mean capacity.
        """
        chain = self.chain(position)
        snr = self.channel.mean_snr_dB(torch.linalg.vector_norm(chain.diff(dim=-2), dim=-1))
        if shadowed:
            # The field's ends stand in the order source < destination < vehicles.
            first, second = chain[..., :-1, :].clone(), chain[..., 1:, :].clone()
            first[..., -1, :], second[..., -1, :] = chain[..., -1, :], chain[..., -2, :]
            snr = snr + self.shadowing(first, second).to(snr.dtype)
        return self.channel.capacity_kbps(snr)
