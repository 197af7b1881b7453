"""Planners: from an estimated channel to an agent."""

from __future__ import annotations

from typing import Protocol

from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent, InterfaceError
from uwirl.world.relay import Relay


class Planner(Protocol):
    """Finds an agent. It may fly in `env` to learn, but knows the channel only through estimate and budget."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """The agent for these worlds."""
        ...


def fitted(planner: Planner, env: Relay, estimate: ChannelEstimate) -> Agent:
    """What `Planner.fit` returns, if it is an agent.

    Raises:
        InterfaceError: it is none.
    """
    agent = planner.fit(env, estimate)
    if not all(callable(getattr(agent, method, None)) for method in ("init", "act")):
        got = "None" if agent is None else f"a {type(agent).__name__}"
        raise InterfaceError(f"{type(planner).__name__}.fit must return an agent, with init and act, got {got}")
    return agent
