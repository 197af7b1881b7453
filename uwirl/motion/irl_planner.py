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
    """Learns by flying; what it learns stands in the state of a `Learning`, not in here."""

    @torch.no_grad()
    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Learn to the end; `uwirl.algorithm` has the same loop, watched."""
        learning = Learning(self, env, estimate)
        state = learning.init()
        while not learning.is_over(state):
            leg, state = learning.fly(state)
            state = learning.improve(state, leg)
        return learning.agent(state.learner.actor, state.trim)
