"""Where worlds stand, and what a flight through them leaves behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from uwirl.world.vehicle import VehicleState


class DivergedError(RuntimeError):
    """A simulated quantity stopped being finite."""


class WorldState(NamedTuple):
    """Where B worlds of M vehicles stand; with their random streams all that follows is determined.

    Attributes:
        components: of the vehicles, [8, B, M]; see VehicleState.
        step: how many steps each world has made, int64 [B].
        target: where each vehicle has said that it means to go, [B, M, 3], m; nan until it has.
    """

    components: Tensor
    step: Tensor
    target: Tensor

    @classmethod
    def of(cls, vehicles: VehicleState, step: int = 0) -> WorldState:
        """Of vehicles [B, M] after so many steps, which have said nothing yet."""
        x = vehicles.components
        silent = x.new_full((), torch.nan).expand(*x.shape[1:], 3)
        return cls(x, torch.full(x.shape[1:2], step, dtype=torch.int64, device=x.device), silent)

    @property
    def vehicles(self) -> VehicleState:
        """[B, M]."""
        return VehicleState(self.components)

    def detached(self) -> WorldState:
        """A copy that shares no memory with the flight that it ended."""
        return self._replace(components=self.components.clone())


@dataclass(frozen=True)
class Trajectory:
    """What a rollout leaves behind.

    Attributes:
        components: states at the n + 1 step boundaries, [n + 1, 8, B, M].
        tau: control held over each step, [n, B, M, 4].
        dt: s.
        first_step: step index, from the beginning of the flight, of the first state.
        end: where the worlds stand then, a view; `end.detached()` does not hold the whole flight in memory.
        carry: what the agent remembers then; with `end` it goes on as if never stopped.
    """

    components: Tensor
    tau: Tensor
    dt: float
    first_step: int
    end: WorldState
    carry: Any = None

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

    def check_finite(self) -> None:
        """Raises DivergedError, which names the first step and quantity, unless all of it is finite."""
        for name in ("tau", "nu", "eta"):
            finite = torch.isfinite(getattr(self, name)).flatten(1).all(1)
            if not bool(finite.all()):
                step = int((~finite).nonzero()[0])
                raise DivergedError(
                    f"{name} is not finite at step {step} (t = {float(self.time[step]):g} s of the flight)"
                )
