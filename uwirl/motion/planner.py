"""Planners: from an estimated channel to an agent."""

from __future__ import annotations

from typing import Protocol

from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.relay import Relay


class Planner(Protocol):
    """Finds an agent. It may fly in `env` to learn, but knows the channel only through estimate and budget."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """The agent for these worlds."""
        ...
