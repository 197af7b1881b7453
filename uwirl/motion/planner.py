"""Planners: from an estimated channel to an agent."""

from __future__ import annotations

from typing import Protocol

from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.relay import Relay


class Planner(Protocol):
    """Finds an agent; may fly in `env` to learn, but knows of the channel what the estimate and the budget tell."""

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent: ...
