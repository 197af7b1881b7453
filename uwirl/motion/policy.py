"""Policies of stage 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.relay import Trajectory
from uwirl.world.vehicle import VehicleState


class Policy(Protocol):
    """What a planner returns and an evaluation flies: (state, step index) -> tau [B, M, 4], saturated by the world."""

    def __call__(self, state: VehicleState, step: int) -> Tensor: ...


class Observer(Protocol):
    """What a linear policy sees of a flight: the state x of its basis."""

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        """x in flight, [B, M, d]."""
        ...

    def along(self, trajectory: Trajectory) -> Tensor:
        """x of a flight that is over, [n + 1, B, M, d]."""
        ...


@dataclass(frozen=True)
class LinkObserver:
    """Sees xi, where a vehicle is relative to its link."""

    frame: LinkFrame

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        """xi [B, M, 8]."""
        return self.frame.relative(state)

    def along(self, trajectory: Trajectory) -> Tensor:
        """xi [n + 1, B, M, 8]."""
        return self.frame.relative(trajectory.states)


class LinearPolicy:
    """tau = tau_trim + W' phi3(x).

    Args:
        observer: sees x.
        actor: its L weight rows belong to L = B M vehicles, or one row to all of them.
        trim: tau that holds the vehicle at rest, [4] or [L, 4].
        excitation: added to the control of each step, [n, B, M, 4]; None for none.
        first_step: the step that the excitation begins with.
    """

    def __init__(
        self,
        observer: Observer,
        actor: LinearActor,
        trim: Tensor,
        excitation: Tensor | None = None,
        first_step: int = 0,
    ):
        self.observer = observer
        self.actor = actor
        self.trim = trim
        self.excitation = excitation
        self.first_step = first_step

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        return self.control(self.observer(state, step), step)

    def control(self, x: Tensor, step: int) -> Tensor:
        """tau [B, M, 4] at x [B, M, d]."""
        tau = (self.trim + self.actor(x.flatten(0, 1))).view(*x.shape[:2], -1).to(x.dtype)
        return tau if self.excitation is None else tau + self.excitation[step - self.first_step]


class LinkFramePolicy(LinearPolicy):
    """tau = tau_trim + W' phi3(xi).

    Args:
        frame: LinkFrame of [M] or [B, M] vehicles.
        actor, trim: see LinearPolicy.
    """

    def __init__(self, frame: LinkFrame, actor: LinearActor, trim: Tensor):
        super().__init__(LinkObserver(frame), actor, trim)
        self.frame = frame
