"""Everything that a vehicle can know about its world at one time step."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from uwirl.world.messages import Messages
from uwirl.world.obstacles import Obstacles


class Observation(NamedTuple):
    """The observation of vehicles [B, M].

    Attributes:
        step: number of the step, from the beginning of the flight, int64 [B].
        dt: duration of a step, s.
        eta: the vehicle's pose, as given by its navigation, [B, M, 4].
        nu: the vehicle's velocity, as given by its navigation, [B, M, 4].
        obstacles: those that each vehicle detects now, or all if they are known; fields [B, M, O(, 2)]; `present` is
            True for detected ones. `centre` is the position of the axis extrapolated to time 0.
        contact: 1 at the surface, -1 at the floor, 0 elsewhere, int8 [B, M].
        messages: received in this step.
    """

    step: Tensor
    dt: float
    eta: Tensor
    nu: Tensor
    obstacles: Obstacles
    contact: Tensor
    messages: Messages

    @property
    def time(self) -> Tensor:
        """Since the beginning of the flight, [B], float64, s."""
        return self.step.double() * self.dt

    @property
    def position(self) -> Tensor:
        """[B, M, 3], a view, m."""
        return self.eta[..., :3]

    def worlds(self, some: slice) -> Observation:
        """The observation of some worlds of the batch; its fields are views."""

        def take(field: Tensor) -> Tensor:
            return field[some]

        return Observation(
            self.step[some],
            self.dt,
            self.eta[some],
            self.nu[some],
            self.obstacles.each(take),
            self.contact[some],
            Messages(*(take(field) for field in self.messages)),
        )
