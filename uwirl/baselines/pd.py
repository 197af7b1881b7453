"""Proportional-derivative control towards the target: the simplest baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from uwirl.irl.networks import LinearActor
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.cost import CostWeights
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.guidance import Guidance
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.mission import Mission
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.agent import Agent, Guard
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class PdPlanner:
    """tau = tau_trim - K_p sat(e) - K_d nu, with each error component saturating smoothly.

    Attributes:
        cost: weights of the running cost, used by the calibration hover to check the gains.
        guard: guard between agent and thrusters during the hover.
        guidance: guidance to the target.
        position_gain: surge, sway, heave in N/m, yaw in N m.
        velocity_gain: surge, sway, heave in N s/m, yaw in N m s/rad.
        saturation_m: L of e / sqrt(1 + e^2/L^2).
        calibration_s: duration of the hover that finds the trim, s.
    """

    cost: CostWeights
    guard: Guard
    guidance: Guidance
    position_gain: Sequence[float]
    velocity_gain: Sequence[float]
    saturation_m: float
    calibration_s: float

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        """Hover to measure the trim, and return the agent."""
        mission = Mission(env, estimate.channel, self.cost)
        (pu, pv, pw, pr), (du, dv, dw, dr) = self.position_gain, self.velocity_gain
        gains = torch.tensor([[pu, pu, du, pv, pv, dv, 0.0, pw, dw, pr, dr, 0.0]], dtype=torch.float64)
        actor = LinearActor(
            LinkFrameBasis(mission.cost, [self.saturation_m]), -gains.to(mission.targets.neighbours.device)
        )
        _, trim = calibration_hover(env, actor, mission.cost, self.calibration_s, self.guard)
        return self.guidance(mission)(LinkController(mission.targets.frame, actor, trim))
