"""Policies of stage 2."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.vehicle import VehicleState


class Policy(Protocol):
    """What a planner returns and an evaluation flies: (state, step index) -> tau [B, M, 4], saturated by the world."""

    def __call__(self, state: VehicleState, step: int) -> Tensor: ...


class LinkFramePolicy:
    """tau = tau_trim + W' phi3(xi).

    Args:
        frame: LinkFrame of [M] or [B, M] vehicles.
        actor: its L weight rows belong to L = B M vehicles, or one row to all of them.
        trim: tau that holds the vehicle at rest, [4] or [L, 4].
        excitation: added to the control of each step, [n, B, M, 4]; None for none.
        first_step: the step that the excitation begins with.
    """

    def __init__(
        self,
        frame: LinkFrame,
        actor: LinearActor,
        trim: Tensor,
        excitation: Tensor | None = None,
        first_step: int = 0,
    ):
        self.frame = frame
        self.actor = actor
        self.trim = trim
        self.excitation = excitation
        self.first_step = first_step

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        xi = self.frame.relative(state)
        tau = (self.trim + self.actor(xi.flatten(0, 1))).view(*xi.shape[:2], -1).to(xi.dtype)
        return tau if self.excitation is None else tau + self.excitation[step - self.first_step]
