"""Proportional-derivative control towards the target: the baseline that anybody would try first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from uwirl.irl.networks import LinearActor
from uwirl.motion.calibration import calibration_hover
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.guidance import Guidance
from uwirl.motion.planner import CostFactory
from uwirl.motion.policy import LinkFramePolicy, Policy
from uwirl.motion.safety import Guard
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.relay import Relay


@dataclass
class PdPlanner:
    """tau = tau_trim - K_p sat(e) - K_d nu, with each error component saturating smoothly.

    Attributes:
        make_cost: the running cost, by which the calibration hover judges the gains.
        position_gain: surge, sway, heave in N/m, yaw in N m.
        velocity_gain: surge, sway, heave in N s/m, yaw in N m s/rad.
        saturation_m: L of e / sqrt(1 + e^2/L^2).
        calibration_s: duration of the hover that finds the trim, s.
        guard: between policy and thrusters during the hover.
        guidance: the way to the target.
    """

    make_cost: CostFactory
    position_gain: Sequence[float]
    velocity_gain: Sequence[float]
    saturation_m: float
    calibration_s: float
    guard: Guard
    guidance: Guidance

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Policy:
        targets = mean_channel_targets(env.scenario, estimate.channel)
        cost = self.make_cost(estimate.channel, targets)
        (pu, pv, pw, pr), (du, dv, dw, dr) = self.position_gain, self.velocity_gain
        gains = torch.tensor([[pu, pu, du, pv, pv, dv, 0.0, pw, dw, pr, dr, 0.0]], dtype=torch.float64)
        actor = LinearActor(LinkFrameBasis(cost, [self.saturation_m]), -gains.to(targets.neighbours.device))
        _, trim = calibration_hover(env, actor, cost, self.calibration_s, self.guard)
        return self.guidance(env, cost, targets)(LinkFramePolicy(targets.frame, actor, trim))
