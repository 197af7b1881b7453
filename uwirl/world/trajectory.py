"""The state of worlds, and the record of a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.world.vehicle import VehicleState


class DivergedError(RuntimeError):
    """A simulated quantity stopped being finite."""


class WorldState(NamedTuple):
    """State of B worlds of M vehicles; with their random streams it determines the future, given the controls.

    Attributes:
        components: poses and velocities, [8, B, M]; see VehicleState.
        step: number of steps made by each world, int64 [B].
        target: target that each vehicle has announced, [B, M, 3], m; nan before it announces one.
    """

    components: Tensor
    step: Tensor
    target: Tensor

    @classmethod
    def of(cls, vehicles: VehicleState, step: int = 0) -> WorldState:
        """A state of vehicles [B, M] at this step, with no announced targets."""
        x = vehicles.components
        silent = x.new_full((), torch.nan).expand(*x.shape[1:], 3)
        return cls(x, torch.full(x.shape[1:2], step, dtype=torch.int64, device=x.device), silent)

    @property
    def vehicles(self) -> VehicleState:
        """Poses and velocities [B, M]."""
        return VehicleState(self.components)

    def detached(self) -> WorldState:
        """A copy that shares no memory with the trajectory."""
        return self._replace(components=self.components.clone())


def at_rest(eta: Tensor) -> WorldState:
    """The state of vehicles at rest at poses eta [B, M, 4], at step 0."""
    return WorldState.of(VehicleState.from_eta_nu(eta))


@dataclass(frozen=True)
class Trajectory:
    """The record of a rollout.

    Attributes:
        components: states at the n + 1 step boundaries, [n + 1, 8, B, M].
        tau: control held over each step, [n, B, M, 4].
        dt: s.
        first_step: step index of the first state, counted from the beginning of the flight.
        end: last state, a view; `end.detached()` is a copy that does not keep the whole flight in memory.
        carry: the agent's memory at the end; `end` and `carry` are enough to continue the flight exactly.
    """

    components: Tensor
    tau: Tensor
    dt: float
    first_step: int
    end: WorldState
    carry: Any = None

    @classmethod
    def joined(cls, flights: Sequence[Trajectory]) -> Trajectory:
        """Flights, each of which continues the one before, as one."""
        components = torch.cat([flights[0].components, *(flight.components[1:] for flight in flights[1:])])
        tau = torch.cat([flight.tau for flight in flights])
        return replace(flights[-1], components=components, tau=tau, first_step=flights[0].first_step)

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
        """State at the end, [B, M]."""
        return VehicleState(self.components[-1])

    @property
    def time(self) -> Tensor:
        """[n + 1], s."""
        n = self.components.shape[0]
        return (self.first_step + torch.arange(n, dtype=torch.float64, device=self.components.device)) * self.dt

    def worlds(self, some: slice) -> Trajectory:
        """The record of some worlds of the batch, views; without the agent's memory."""
        end = WorldState(self.end.components[:, some], self.end.step[some], self.end.target[some])
        return Trajectory(self.components[:, :, some], self.tau[:, some], self.dt, self.first_step, end)

    def check_finite(self) -> None:
        """Raise DivergedError, naming the first step and quantity, if any value is not finite."""
        for name in ("tau", "nu", "eta"):
            finite = torch.isfinite(getattr(self, name)).flatten(1).all(1)
            if not bool(finite.all()):
                step = int((~finite).nonzero()[0])
                raise DivergedError(
                    f"{name} is not finite at step {step} (t = {float(self.time[step]):g} s of the flight)"
                )
