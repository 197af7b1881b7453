"""Agents, which control vehicles: they get an Observation and return tau; their memory is a carry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.world.observation import Observation


class InterfaceError(ValueError):
    """An object, perhaps of the user's own, returned what its interface does not allow; the message says which."""


class Agent(Protocol):
    """Controls vehicles. Both methods are pure: the same call gives the same result, and the carry is the only memory.

    A carry is a NamedTuple of tensors or of further such NamedTuples, so that a flight can be stopped, saved, continued
    bitwise, batched and moved to another device. If a carry has an attribute `target` [B, M, 3], these targets are
    announced to the other vehicles; an attribute `blocked` [B, M] marks vehicles without a free route to their target.
    """

    def init(self, observation: Observation) -> Any:
        """The carry at the beginning of a flight."""
        ...

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """tau [B, M, 4], which the world saturates and holds for one step, and the next carry."""
        ...


# Between an agent and the thrusters: from the wanted tau [B, M, 4] to a safe one.
Guard = Callable[[Tensor, Observation], Tensor]


def check_shape(name: str, value: object, shape: torch.Size, axes: str = "world, vehicle, axis") -> None:
    """Check that a value is a tensor of the needed shape: tau [B, M, 4] or a target [B, M, 3].

    Args:
        name: name of the value, for the message.
        value: anything.
        shape: the needed shape.
        axes: what they are.

    Raises:
        InterfaceError: the value is not a floating-point tensor of that shape.
    """
    if isinstance(value, Tensor) and value.is_floating_point() and value.shape == shape:
        return
    got = f"{value.dtype} {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
    raise InterfaceError(f"{name} must be floating-point {list(shape)} ({axes}), got {got}")


def decide(agent: Agent, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
    """Call `Agent.act` and check its result: tau [B, M, 4] and the next carry.

    Raises:
        InterfaceError: the agent did not return a pair, or tau has another type or shape.
    """
    name, action = type(agent).__name__, agent.act(carry, observation)
    if not (isinstance(action, tuple) and len(action) == 2):
        raise InterfaceError(f"{name}.act must return (tau, carry), got {type(action).__name__}")
    check_shape(f"tau of {name}.act", action[0], observation.eta.shape)
    return action


@dataclass(frozen=True)
class Feedback:
    """An agent without memory.

    Attributes:
        law: function of an observation, returns tau [B, M, 4].
    """

    law: Callable[[Observation], Tensor]

    def init(self, observation: Observation) -> tuple[()]:
        """Nothing is remembered."""
        return ()

    def act(self, carry: tuple[()], observation: Observation) -> tuple[Tensor, tuple[()]]:
        """tau from the law."""
        return self.law(observation), carry


@dataclass(frozen=True)
class Guarded:
    """An agent behind a guard."""

    agent: Agent
    guard: Guard

    def init(self, observation: Observation) -> Any:
        """The carry of the agent."""
        return self.agent.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """The agent's tau, changed by the guard."""
        tau, carry = decide(self.agent, carry, observation)
        return self.guard(tau, observation), carry


def slices(numbers: Sequence[int]) -> list[slice]:
    """Consecutive parts of a batch, of these numbers of worlds."""
    return [slice(end - n, end) for end, n in zip(accumulate(numbers), numbers, strict=True)]


class SideBySideCarry(NamedTuple):
    """Memory of agents that fly side by side.

    Attributes:
        parts: the carry of each agent.
        silent: for each agent, the target of vehicles that announce none: nan, [its worlds, M, 3].
    """

    parts: tuple[Any, ...]
    silent: tuple[Tensor, ...]

    @property
    def target(self) -> Tensor:
        """Targets that the agents announce, [B, M, 3], m; nan where an agent announces none."""
        each = zip(self.parts, self.silent, strict=True)
        return torch.cat([getattr(part, "target", silent) for part, silent in each])

    @property
    def blocked(self) -> Tensor:
        """Whether an agent knows no free route to the vehicle's target, [B, M]."""
        each = zip(self.parts, self.silent, strict=True)
        return torch.cat([getattr(part, "blocked", ~silent[..., 0].isnan()) for part, silent in each])


@dataclass(frozen=True)
class SideBySide:
    """Several agents in one batch of worlds, which takes less time than one flight after the other.

    Attributes:
        agents: each flies in worlds of its own.
        worlds: the number of worlds of each; the first agent has the first worlds.
    """

    agents: Sequence[Agent]
    worlds: Sequence[int]

    def init(self, observation: Observation) -> SideBySideCarry:
        """The carries of all agents."""
        seen = self._split(observation)
        parts = tuple(agent.init(part) for agent, part in zip(self.agents, seen, strict=True))
        return SideBySideCarry(parts, tuple(torch.full_like(part.position, torch.nan) for part in seen))

    def act(self, carry: SideBySideCarry, observation: Observation) -> tuple[Tensor, SideBySideCarry]:
        """tau [B, M, 4] of all agents, and their next carries."""
        seen = self._split(observation)
        acts = [decide(*each) for each in zip(self.agents, carry.parts, seen, strict=True)]
        return torch.cat([tau for tau, _ in acts]), carry._replace(parts=tuple(part for _, part in acts))

    def _split(self, observation: Observation) -> list[Observation]:
        return [observation.worlds(some) for some in slices(self.worlds)]
