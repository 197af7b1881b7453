"""What a vehicle can know of its world at one moment, and nothing else."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from uwirl.world.messages import Messages
from uwirl.world.obstacles import Obstacles


class Observation(NamedTuple):
    """What the vehicles [B, M] perceive.

    Attributes:
        step: of the flight, int64 [B].
        time: since the flight began, [B], float64, s.
        eta: own pose, by its own navigation, [B, M, 4].
        nu: own velocity, likewise, [B, M, 4].
        obstacles: those that each vehicle detects now, or all of a known map; fields [B, M, O(, 2)], `present` only
            where detected. Their axes are given where they were, or would have been, at time 0.
        contact: whether it touches the surface (1), the floor (-1) or neither (0), int8 [B, M].
        messages: received in this step.
    """

    step: Tensor
    time: Tensor
    eta: Tensor
    nu: Tensor
    obstacles: Obstacles
    contact: Tensor
    messages: Messages

    @property
    def position(self) -> Tensor:
        """[B, M, 3], a view, m."""
        return self.eta[..., :3]
