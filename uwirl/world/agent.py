"""What flies a vehicle: it perceives an Observation and acts, and all that it remembers is in its carry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from uwirl.world.observation import Observation


class Agent(Protocol):
    """Pure in both methods: the same call twice gives the same, and nothing is kept between calls but the carry.

    A carry is a NamedTuple of tensors (or of such), so that a flight can be stopped, saved, continued bitwise, batched
    and moved to another device. One that has an attribute `target` [B, M, 3] tells the other vehicles where each means
    to go; one that has `blocked` [B, M] says which of them found no way there.
    """

    def init(self, observation: Observation) -> Any:
        """The carry at the beginning of a flight."""
        ...

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """tau [B, M, 4], which the world saturates and holds for one step, and the next carry."""
        ...


# Between an agent and the thrusters: from the tau [B, M, 4] that is wanted to the one that is safe.
Guard = Callable[[Tensor, Observation], Tensor]


def check_shape(name: str, value: object, shape: torch.Size) -> None:
    """Refuse what is no tau [B, M, 4] or no target [B, M, 3].

    Args:
        name: what it should be, for the message.
        value: anything.
        shape: that is needed.

    Raises:
        ValueError: it is no floating-point tensor of that shape.
    """
    if isinstance(value, Tensor) and value.is_floating_point() and value.shape == shape:
        return
    got = f"{value.dtype} {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
    raise ValueError(f"{name} must be floating-point {list(shape)} (world, vehicle, axis), got {got}")


def decide(agent: Agent, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
    """What an agent does, if that is what `Agent.act` promises: tau [B, M, 4] and the next carry.

    Raises:
        ValueError: it returned no pair, or something else in place of tau.
    """
    name, action = type(agent).__name__, agent.act(carry, observation)
    if not (isinstance(action, tuple) and len(action) == 2):
        raise ValueError(f"{name}.act must return (tau, carry), got {type(action).__name__}")
    check_shape(f"tau of {name}.act", action[0], observation.eta.shape)
    return action


@dataclass(frozen=True)
class Feedback:
    """An agent without memory.

    Attributes:
        law: from an observation to tau [B, M, 4].
    """

    law: Callable[[Observation], Tensor]

    def init(self, observation: Observation) -> tuple[()]:
        """Nothing is remembered."""
        return ()

    def act(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """tau by the law."""
        return self.law(observation), carry


@dataclass(frozen=True)
class Guarded:
    """An agent behind a guard."""

    agent: Agent
    guard: Guard

    def init(self, observation: Observation) -> Any:
        """That of the agent."""
        return self.agent.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """What the guard makes of the agent's tau."""
        tau, carry = decide(self.agent, carry, observation)
        return self.guard(tau, observation), carry
