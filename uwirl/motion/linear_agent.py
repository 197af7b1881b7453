"""Agents that are linear in learned weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.agent import Agent
from uwirl.world.observation import Observation
from uwirl.world.trajectory import Trajectory
from uwirl.world.vehicle import Moving


class View(Protocol):
    """Computes the state x of a linear agent's basis from its observations. Pure, like agents."""

    def init(self, observation: Observation) -> Any:
        """The carry at the beginning of a flight."""
        ...

    def see(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """x of an observation, [B, M, d], and the next carry."""
        ...

    def along(self, carry: Any, trajectory: Trajectory) -> Tensor:
        """x of a completed flight, [n + 1, B, M, d], with the carry at its end."""
        ...


@dataclass(frozen=True)
class LinkView:
    """Computes xi, the state of a vehicle relative to its link; without memory."""

    frame: LinkFrame

    def init(self, observation: Observation) -> tuple[()]:
        """The empty carry."""
        return ()

    def see(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """xi [B, M, 8] of an observation."""
        return self.frame.relative(observation), carry

    def along(self, carry: tuple[()], trajectory: Trajectory) -> Tensor:
        """xi [n + 1, B, M, 8] of a trajectory."""
        return self.frame.relative(trajectory.states)


def linear_control(actor: LinearActor, trim: Tensor, x: Tensor) -> Tensor:
    """tau = tau_trim + W' phi3(x), [B, M, 4] at x [B, M, d].

    Args:
        actor: actor with L = B M rows of weights, one per vehicle, or with one row for all.
        trim: tau that holds the vehicle at rest, [4] or [L, 4].
        x: state of the actor's basis.
    """
    return (trim + actor(x.flatten(0, 1))).view(*x.shape[:2], -1).to(x.dtype)


@dataclass(frozen=True)
class LinearAgent:
    """tau = tau_trim + W' phi3(x).

    Attributes:
        view: computes x; its carry is the agent's carry.
        actor, trim: see `linear_control`.
    """

    view: View
    actor: LinearActor
    trim: Tensor

    def init(self, observation: Observation) -> Any:
        """The carry of the view."""
        return self.view.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """tau [B, M, 4] and the next carry."""
        x, carry = self.view.see(carry, observation)
        return linear_control(self.actor, self.trim, x), carry


@dataclass(frozen=True)
class Excited:
    """An agent whose control an excitation is added to.

    Attributes:
        agent: any.
        excitation: added at each step, [n, B, M, 4]; N, N m.
        first_step: step of the first excitation.
    """

    agent: Agent
    excitation: Tensor
    first_step: int

    def init(self, observation: Observation) -> Any:
        """The agent's carry."""
        return self.agent.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """tau [B, M, 4] and the next carry."""
        tau, carry = self.agent.act(carry, observation)
        # Indexed by a tensor: a number would first have to be copied from the device.
        return tau + self.excitation.index_select(0, observation.step[:1] - self.first_step)[0], carry


@dataclass(frozen=True)
class LinkController:
    """tau = tau_trim + W' phi3(xi) towards a link's target; without memory, so other agents can use it as a part.

    Attributes:
        frame: link frames of [M] or [B, M] vehicles.
        actor, trim: see `linear_control`.
    """

    frame: LinkFrame
    actor: LinearActor
    trim: Tensor

    def control(self, state: Moving) -> Tensor:
        """tau [B, M, 4] for a state [B, M]."""
        return linear_control(self.actor, self.trim, self.frame.relative(state))

    def towards(self, frame: LinkFrame) -> LinkController:
        """The same controller with another target."""
        return LinkController(frame, self.actor, self.trim)

    def init(self, observation: Observation) -> tuple[()]:
        """The empty carry."""
        return ()

    def act(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """tau [B, M, 4] and the next carry."""
        return self.control(observation), carry
