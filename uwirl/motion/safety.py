"""The guard between a policy and the thrusters: the last line against obstacles, also while learning.

For a clearance d that changes no faster than the vehicle moves (any union of shapes),

    h = d - margin - m_bar |nu|^2 / (2 tau_b)

cannot become negative if m_bar is at least the vehicle's mass, tau_b at most its thrust, and h >= 0 at first: full
braking spends kinetic energy as fast as clearance. Sampled at dt, the condition on tau is a ball for each obstacle,

    beta |tau|^2 + (nu - tau_b beta n)' tau <= tau_b (n . nu + alpha h),   beta = dt / (2 m_lo)

with n the horizontal unit vector from obstacle to vehicle in body axes and nu the velocity relative to the obstacle.
Nothing of the dynamics is used but these bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.policy import Policy
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

# Wraps a policy.
Guard = Callable[[Relay, Policy], Policy]

PROJECTIONS = 3


def unguarded(env: Relay, policy: Policy) -> Policy:
    """safety=none."""
    return policy


@dataclass(frozen=True)
class EnergyGuard:
    """safety=energy.

    Attributes:
        margin_m: clearance to keep, m.
        alpha: how fast h may fall, 1/s.
        mass_upper_kg: m_bar, at least the horizontal inertia, kg.
        mass_lower_kg: m_lo, at most the horizontal inertia, kg.
        brake_force_N: tau_b, at most the horizontal thrust less any disturbance, N.
    """

    margin_m: float
    alpha: float
    mass_upper_kg: float
    mass_lower_kg: float
    brake_force_N: float

    def __call__(self, env: Relay, policy: Policy) -> Policy:
        """The policy, with surge and sway forces changed as little as safety asks for."""
        scenario, vehicle = env.scenario, env.vehicle
        if scenario.obstacles.count == 0:
            return policy

        def guarded(state: VehicleState, step: int) -> Tensor:
            tau = vehicle.saturate(policy(state, step))
            psi = state.eta[..., 3]
            c, s = torch.cos(psi)[..., None], torch.sin(psi)[..., None]
            time = step * scenario.dt
            offset = scenario.obstacles.offset(state.position, time)
            clearance = scenario.obstacles.clearance(state.position, scenario.vehicle_radius, time)
            n = offset / torch.linalg.vector_norm(offset, dim=-1, keepdim=True).clamp_min(1e-9)
            velocity = scenario.obstacles.velocity.expand(*offset.shape[:-3], *scenario.obstacles.velocity.shape[-2:])
            relative = state.nu[..., None, :2] - _to_body(velocity[..., None, :, :].expand_as(offset), c, s)
            force = self.filter(tau[..., :2], _to_body(n, c, s), relative, clearance, vehicle.tau_max[:2], scenario.dt)
            return torch.cat([force, tau[..., 2:]], -1)

        return guarded

    def filter(self, force: Tensor, n: Tensor, nu: Tensor, clearance: Tensor, force_max: Tensor, dt: float) -> Tensor:
        """The admissible force nearest to the wanted one, up to three projections; failing that, full braking.

        Args:
            force: wanted surge and sway force, within the limits, [..., 2], N.
            n: unit vectors from obstacles to vehicle, body axes, [..., O, 2].
            nu: velocity relative to each obstacle, body axes, [..., O, 2], m/s.
            clearance: [..., O], m; infinite where there is none.
            force_max: [2], N.
            dt: time for which the force is held, s.

        Returns:
            [..., 2], N.
        """
        speed = torch.linalg.vector_norm(nu, dim=-1)
        h = clearance - self.margin_m - self.mass_upper_kg * speed.square() / (2.0 * self.brake_force_N)
        beta = dt / (2.0 * self.mass_lower_kg)
        drift = nu - self.brake_force_N * beta * n
        centre = -drift / (2.0 * beta)
        allowed = self.brake_force_N * ((n * nu).sum(-1) + self.alpha * h)
        radius = (allowed / beta + centre.square().sum(-1)).clamp_min(0.0).sqrt()
        safe = force
        for _ in range(PROJECTIONS):
            away = safe[..., None, :] - centre
            distance = torch.linalg.vector_norm(away, dim=-1)
            excess, worst = (distance - radius).max(-1, keepdim=True)
            scale = radius.gather(-1, worst) / distance.gather(-1, worst).clamp_min(1e-9)
            projected = _pick(centre, worst) + _pick(away, worst) * scale
            safe = torch.where(excess > 0.0, projected, safe)
            safe = torch.maximum(torch.minimum(safe, force_max), -force_max)
        violated = (torch.linalg.vector_norm(safe[..., None, :] - centre, dim=-1) - radius).amax(-1, keepdim=True)
        nearest = h.argmin(-1, keepdim=True)
        braking_speed = speed.gather(-1, nearest)
        # No more than stops the vehicle within the step, or it would be thrown back.
        brake = (self.mass_lower_kg * braking_speed / dt).clamp_max(self.brake_force_N)
        braking = -brake * _pick(nu, nearest) / braking_speed.clamp_min(1e-9)
        return torch.where(violated > 0.5, braking, safe)


def _to_body(vector: Tensor, c: Tensor, s: Tensor) -> Tensor:
    """Horizontal vectors [..., O, 2] of the inertial frame in body axes of yaw with cosine and sine [..., 1]."""
    x, y = vector.unbind(-1)
    return torch.stack([c * x + s * y, c * y - s * x], -1)


def _pick(vectors: Tensor, index: Tensor) -> Tensor:
    """[..., 2] of [..., O, 2] at [..., 1]."""
    return vectors.gather(-2, index[..., None].expand(*index.shape, 2))[..., 0, :]
