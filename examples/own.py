"""A vehicle, a channel, an estimator, a basis and a planner of one's own; docs/extending.md has the commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.acoustics import LinkBudget
from uwirl.world.agent import Agent, Feedback
from uwirl.world.geometry import rotation_matrix
from uwirl.world.observation import Observation
from uwirl.world.readings import Readings
from uwirl.world.relay import Relay
from uwirl.world.vehicle import Vehicle, VehicleState


class WornThrusters(Vehicle):
    """Thrusters that do not turn below some command.

    Args:
        dead_zone: of surge, sway, heave (N) and yaw (N m).
        parameters: those of every vehicle.
    """

    def __init__(self, dead_zone: Sequence[float], **parameters: Any):
        super().__init__(**parameters)
        self.register_buffer("dead_zone", self.tau_max.new_tensor(dead_zone))

    def step(
        self, state: VehicleState, tau: Tensor, dt: float, current: Tensor | None = None, out: Tensor | None = None
    ) -> VehicleState:
        return super().step(state, torch.where(tau.abs() < self.dead_zone, 0.0, tau), dt, current, out)


@dataclass(frozen=True)
class CodedModem(LinkBudget):
    """A modem whose code stays some decibels behind Shannon's capacity: C = B log2(1 + SNR / gap).

    Attributes:
        gap_dB: the gap, dB.
    """

    gap_dB: float = 0.0

    def capacity_kbps(self, snr_dB: Tensor) -> Tensor:
        return super().capacity_kbps(snr_dB - self.gap_dB)

    def snr_for_dB(self, capacity_kbps: float) -> float:
        return super().snr_for_dB(capacity_kbps) + self.gap_dB


def known_exponent(readings: Readings, budget: LinkBudget, n: float) -> ChannelEstimate:
    """K alone, where the way in which sound spreads is known.

    Args:
        readings: B data sets.
        budget: noise, bandwidth, absorption.
        n: the spreading exponent.
    """
    loss = 10.0 * n * torch.log10(readings.distance) + budget.known_loss_dB(readings.distance)
    level = (readings.snr + loss).flatten(1)
    K, count = level.nanmean(1), (~level.isnan()).sum(1)
    power = (level - K[:, None]).square().nansum(1) / (count - 1)
    covariance = torch.zeros(len(K), 5, 5, dtype=torch.float64)
    covariance[:, 0, 0] = power / count
    nothing = torch.zeros_like(K)
    return ChannelEstimate(
        budget=budget,
        # What is left of the fading is taken for multipath: zeta^2 = 0, and any varphi.
        value=torch.stack([K, torch.full_like(K, n), nothing, torch.ones_like(K), power], -1),
        covariance=covariance,
        identifiable=torch.tensor([True, True, False, False, True]).expand(len(K), 5),
        cost=0.5 * count * (1.0 + power.log()),
        evaluations=1,
    )


class HyperbolicBasis(LinkFrameBasis):
    """Errors saturate as g_L(e) = L tanh(e / L), whose integral is L^2 log cosh(e / L)."""

    def __init__(self, cost: Any, length_scales_m: Sequence[float]):
        super().__init__(cost, length_scales_m)

    def saturated(self, error: Tensor, L: float) -> tuple[Tensor, Tensor]:
        x = error / L
        log_cosh = x.abs() + torch.log1p(torch.exp(-2.0 * x.abs())) - torch.log(x.new_tensor(2.0))
        return L * torch.tanh(x), L**2 * log_cosh


class Pursuit:
    """Flies at its target with a steady speed, and holds it there; the trim is told, not measured.

    Args:
        speed_mps: on the way, m/s.
        slow_m: distance at which it begins to slow down, m.
        gain: N s/m; yaw is damped by a tenth of it, N m s/rad.
    """

    def __init__(self, speed_mps: float, slow_m: float = 2.0, gain: float = 60.0):
        self.speed_mps, self.slow_m, self.gain = speed_mps, slow_m, gain

    def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
        target = mean_channel_targets(env.scenario, estimate.channel).frame.target

        def law(observation: Observation) -> Tensor:
            error = target - observation.position
            distance = torch.linalg.vector_norm(error, dim=-1, keepdim=True)
            wanted = torch.zeros_like(observation.nu)
            wanted[..., :3] = error * (self.speed_mps / distance.clamp_min(self.slow_m))
            J = rotation_matrix(observation.eta[..., 3])
            wanted = (J.mT @ wanted[..., None])[..., 0]
            gain = wanted.new_tensor([self.gain, self.gain, self.gain, 0.1 * self.gain])
            return env.vehicle.trim + gain * (wanted - observation.nu)

        return Feedback(law)
