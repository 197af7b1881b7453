"""Artificial potential field: drawn to the target, pushed off obstacles; known to stop in dead ends.

    F = -grad (U_att + U_rep) - K_d nu,   U_rep = eta / 2 sum max(0, 1/d - 1/d_0)^2

with d the clearance (O. Khatib, "Real-time obstacle avoidance for manipulators and mobile robots", International
Journal of Robotics Research 5(1), 1986), on top of the proportional-derivative baseline as the attraction.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.baselines.pd import PdPlanner
from uwirl.motion.policy import Policy
from uwirl.motion.safety import obstacle_neighbours
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState


@dataclass
class PotentialField:
    """planner=potential_field.

    Attributes:
        attraction: the PD planner.
        repulsion: eta, N m^3.
        reach_m: d_0, clearance at which the repulsion begins, m.
    """

    attraction: PdPlanner
    repulsion: float
    reach_m: float

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Policy:
        attracted = self.attraction.fit(env, estimate)
        if env.scenario.obstacles.count == 0:
            return attracted

        def policy(state: VehicleState, step: int) -> Tensor:
            near = obstacle_neighbours(env, state, step * env.scenario.dt)
            # Finite in contact, where a field has nothing to say any more.
            d = near.clearance.clamp_min(0.05)
            size = self.repulsion * (1.0 / d - 1.0 / self.reach_m).clamp_min(0.0) / d.square()
            push = (size[..., None] * near.n).sum(-2)
            tau = attracted(state, step)
            return torch.cat([tau[..., :3] + push, tau[..., 3:]], -1)

        return policy
