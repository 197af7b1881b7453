"""Artificial potential field: attraction to the target, repulsion by obstacles; it stops in dead ends.

    F = -grad (U_att + U_rep) - K_d nu,   U_rep = eta / 2 sum max(0, 1/d - 1/d_0)^2

with d the clearance (O. Khatib, "Real-time obstacle avoidance for manipulators and mobile robots", International
Journal of Robotics Research 5(1), 1986). The attraction is the proportional-derivative baseline.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from uwirl.baselines.pd import PdPlanner
from uwirl.motion.guidance import Straight
from uwirl.motion.safety import obstacle_neighbours
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class PotentialField(PdPlanner):
    """planner=potential_field.

    Attributes:
        repulsion: eta, N m^3.
        reach_m: d_0, clearance at which the repulsion begins, m.
    """

    repulsion: float
    reach_m: float

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """The PD agent with repulsion by obstacles."""
        # A potential field needs no route.
        attracted = replace(self, guidance=Straight())
        agent = PdPlanner.fit(attracted, env, estimate)
        return Repelled(agent, self.repulsion, self.reach_m, env.scenario.vehicle_radius)


@dataclass(frozen=True)
class Repelled:
    """An agent with repulsion by obstacles.

    Attributes:
        agent: the agent without repulsion.
        repulsion: eta, N m^3.
        reach_m: d_0, m.
        vehicle_radius: m.
    """

    agent: Agent
    repulsion: float
    reach_m: float
    vehicle_radius: float

    def init(self, observation: Observation) -> Any:
        """The carry of the agent."""
        return self.agent.init(observation)

    def act(self, carry: Any, observation: Observation) -> tuple[Tensor, Any]:
        """The agent's tau plus the repulsion, [B, M, 4]."""
        tau, carry = self.agent.act(carry, observation)
        if observation.obstacles.number == 0:
            return tau, carry
        near = obstacle_neighbours(observation, self.vehicle_radius)
        # Kept finite at contact, where the field is not defined.
        d = near.clearance.clamp_min(0.05)
        size = self.repulsion * (1.0 / d - 1.0 / self.reach_m).clamp_min(0.0) / d.square()
        push = (size[..., None] * near.n).sum(-2)
        return torch.cat([tau[..., :3] + push, tau[..., 3:]], -1), carry
