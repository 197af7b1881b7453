"""planner=irl: model-free integral reinforcement learning (Algorithm 1, second loop)."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from uwirl.motion.irl_settings import IrlSettings
from uwirl.motion.learning import Learning
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class IrlPlanner(IrlSettings):
    """Learns by flying; the results are in the state of a `Learning`, not in this object."""

    @torch.no_grad()
    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Learn until the weights settle or the time is up."""
        learning = Learning(self, env, estimate)
        state = learning.init()
        while not learning.is_over(state):
            state = learning.step(state)
        return learning.agent(state.learner.actor, state.trim, known=state.known)
