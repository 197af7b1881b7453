"""Agents that are linear in learned weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.observation import Observation
from uwirl.world.trajectory import Trajectory
from uwirl.world.vehicle import Moving


class View(Protocol):
    """What a linear agent makes of its observations: the state x of its basis. Pure, as agents are."""

    def init(self, observation: Observation) -> Any:
        """What is remembered at the beginning of a flight."""
        ...

    def see(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """x in flight, [B, M, d], and what is remembered then."""
        ...

    def along(self, carry: Any, trajectory: Trajectory) -> Tensor:
        """x of a flight that is over, [n + 1, B, M, d], by what was remembered at its end."""
        ...


@dataclass(frozen=True)
class LinkView:
    """Sees xi, where a vehicle is relative to its link; remembers nothing."""

    frame: LinkFrame

    def init(self, observation: Observation) -> tuple[()]:
        """Nothing."""
        return ()

    def see(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """xi [B, M, 8]."""
        return self.frame.relative(observation), carry

    def along(self, carry: tuple[()], trajectory: Trajectory) -> Tensor:
        """xi [n + 1, B, M, 8]."""
        return self.frame.relative(trajectory.states)


def linear_control(actor: LinearActor, trim: Tensor, x: Tensor) -> Tensor:
    """tau = tau_trim + W' phi3(x), [B, M, 4] at x [B, M, d].

    Args:
        actor: its L weight rows belong to L = B M vehicles, or one row to all of them.
        trim: tau that holds the vehicle at rest, [4] or [L, 4].
        x: state of the actor's basis.
    """
    return (trim + actor(x.flatten(0, 1))).view(*x.shape[:2], -1).to(x.dtype)


@dataclass(frozen=True)
class LinearAgent:
    """tau = tau_trim + W' phi3(x), and what excites it.

    Attributes:
        view: sees x; the agent remembers what the view does.
        actor, trim: see `linear_control`.
        excitation: added to the control of each step, [n, B, M, 4]; None for none.
        first_step: the step that the excitation begins with.
    """

    view: View
    actor: LinearActor
    trim: Tensor
    excitation: Tensor | None = None
    first_step: int = 0

    def init(self, observation: Observation) -> Any:
        """That of the view."""
        return self.view.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """tau [B, M, 4]."""
        x, carry = self.view.see(carry, observation)
        tau = linear_control(self.actor, self.trim, x)
        if self.excitation is None:
            return tau, carry
        # By a tensor of one index: as a number it would have to come from the device first.
        return tau + self.excitation.index_select(0, observation.step[:1] - self.first_step)[0], carry


@dataclass(frozen=True)
class LinkController:
    """tau = tau_trim + W' phi3(xi) towards a link's target: no memory, so it serves others as a part, too.

    Attributes:
        frame: of [M] or [B, M] vehicles.
        actor, trim: see `linear_control`.
    """

    frame: LinkFrame
    actor: LinearActor
    trim: Tensor

    def control(self, state: Moving) -> Tensor:
        """tau [B, M, 4] at a state [B, M]."""
        return linear_control(self.actor, self.trim, self.frame.relative(state))

    def towards(self, frame: LinkFrame) -> LinkController:
        """The same to another target."""
        return LinkController(frame, self.actor, self.trim)

    def init(self, observation: Observation) -> tuple[()]:
        """Nothing is remembered."""
        return ()

    def act(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """tau [B, M, 4]."""
        return self.control(observation), carry
