"""The guard between an agent and the thrusters: prevents collisions with obstacles and vehicles, also while learning.

For a clearance d that changes at most as fast as the vehicle moves (true for any union of shapes),

    h = d - margin - m_bar |nu|^2 / (2 tau_b)

can be kept nonnegative if m_bar is at least the vehicle's mass, tau_b at most its thrust, and h >= 0 at first: full
braking reduces kinetic energy as fast as clearance. Sampled at dt, the condition on tau is a ball per obstacle,

    beta |tau|^2 + (nu - tau_b beta n)' tau <= tau_b (n . nu + alpha h),   beta = dt / (2 m_lo)

with n the unit vector from obstacle to vehicle in body axes and nu the velocity relative to the obstacle, both
horizontal. Two vehicles share their condition, in three dimensions: with h = d - separation - m_bar (|nu_i|^2 +
|nu_j|^2) / (2 tau_b), each satisfies the same ball with its own nu and half of alpha h. This needs only position and
speed of the other vehicle. Of the dynamics, only the bounds are used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import length, none_known, turned_to_body
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay

PROJECTIONS = 3
# Number of steps in which full braking aims to regain a lost h.
RECOVERY_STEPS = 4


class Neighbours(NamedTuple):
    """C obstacles or vehicles that a vehicle must avoid.

    Attributes:
        n: unit vectors from them to the vehicle, body axes, [B, M, C, 3].
        nu: velocity to brake: relative to an obstacle, or the vehicle's own if it avoids a vehicle, [B, M, C, 3], m/s.
        clearance: distance minus margin or separation, [B, M, C], m; infinite if there is no obstacle or vehicle.
        axes: 1 for directions in which the clearance is kept, otherwise 0, [C, 3].
    """

    n: Tensor
    nu: Tensor
    clearance: Tensor
    axes: Tensor


class Limits(NamedTuple):
    """What a guard needs to know about its vehicle, in addition to its own settings.

    Attributes:
        tau_max: thruster limits, [4].
        dt: time for which a control is held, s.
        vehicle_radius: m.
    """

    tau_max: Tensor
    dt: float
    vehicle_radius: float

    @classmethod
    def of(cls, env: Relay) -> Limits:
        """The limits of an environment's vehicles."""
        return cls(env.vehicle.tau_max, env.scenario.dt, env.scenario.vehicle_radius)


@dataclass(frozen=True)
class Unguarded:
    """safety=none: no guard."""

    limits: Limits | None = None

    def __call__(self, tau: Tensor, observation: Observation) -> Tensor:
        """tau, unchanged."""
        return tau


def nothing_near(observation: Observation) -> bool:
    """Whether there are no obstacles and no other vehicles."""
    return observation.obstacles.number == 0 and observation.eta.shape[-2] == 1


@dataclass(frozen=True)
class EnergyGuard:
    """safety=energy; the defaults suit a BlueROV2.

    Attributes:
        limits: of the vehicle.
        margin_m: clearance to keep from obstacles, m.
        separation_m: distance to keep between the centres of vehicles, m.
        alpha: how fast h may fall, 1/s.
        mass_upper_kg: m_bar, at least the inertia in surge and sway, and in heave where there are several vehicles, kg.
        mass_lower_kg: m_lo, at most that inertia, kg.
        brake_force_N: tau_b, at most the thrust on these axes less any disturbance, N.
    """

    limits: Limits
    margin_m: float = 0.1
    separation_m: float = 1.0
    alpha: float = 2.0
    mass_upper_kg: float = 30.0
    mass_lower_kg: float = 12.0
    brake_force_N: float = 80.0

    def __call__(self, tau: Tensor, observation: Observation) -> Tensor:
        """tau [B, M, 4], with the smallest change of its forces that is safe."""
        if nothing_near(observation):
            return tau
        tau = torch.clamp(tau, -self.limits.tau_max, self.limits.tau_max)
        groups = []
        if observation.obstacles.number:
            groups.append(self._obstacles(observation))
        if observation.eta.shape[-2] > 1:
            groups.append(self._vehicles(observation))
        return torch.cat([self.filter(tau[..., :3], groups), tau[..., 3:]], -1)

    def _obstacles(self, observation: Observation) -> tuple[Neighbours, Tensor]:
        """Detected obstacles, and h for each."""
        near = obstacle_neighbours(observation, self.limits.vehicle_radius)
        near = near._replace(clearance=near.clearance - self.margin_m)
        return near, near.clearance - self._braking_distance(near.nu.square().sum(-1))

    def _vehicles(self, observation: Observation) -> tuple[Neighbours, Tensor]:
        """The other vehicles of the same world, and half of h, the share that each vehicle must keep."""
        near = vehicle_neighbours(observation)
        near = near._replace(clearance=near.clearance - self.separation_m)
        own = observation.nu[..., :3].square().sum(-1)
        others = observation.messages.nu[..., :3].square().sum(-1)
        h = near.clearance - self._braking_distance(own[..., :, None] + others)
        return near, 0.5 * h

    def _braking_distance(self, speed_squared: Tensor) -> Tensor:
        return self.mass_upper_kg * speed_squared / (2.0 * self.brake_force_N)

    def filter(self, force: Tensor, groups: list[tuple[Neighbours, Tensor]]) -> Tensor:
        """The admissible force nearest to the wanted one, by up to three projections; if that fails, full braking.

        Args:
            force: wanted surge, sway and heave force, within the limits, [B, M, 3], N.
            groups: obstacles or vehicles to avoid, each with its share of h [B, M, C], m.

        Returns:
            [B, M, 3], N.
        """
        n, nu = (torch.cat([getattr(near, name) for near, _ in groups], -2) for name in ("n", "nu"))
        axes = torch.cat([near.axes for near, _ in groups])
        h = torch.cat([h for _, h in groups], -1)
        force_max, dt = self.limits.tau_max[:3], self.limits.dt
        beta = dt / (2.0 * self.mass_lower_kg)
        drift = nu - self.brake_force_N * beta * n
        centre = -drift / (2.0 * beta)
        allowed = self.brake_force_N * ((n * nu).sum(-1) + self.alpha * h)
        radius = (allowed / beta + centre.square().sum(-1)).clamp_min(0.0).sqrt()
        safe = force
        for _ in range(PROJECTIONS):
            away = (safe[..., None, :] - centre) * axes
            distance = length(away)
            excess, worst = (distance - radius).max(-1, keepdim=True)
            if none_known(excess > 0.0):
                return safe
            shrink = 1.0 - radius.gather(-1, worst) / distance.gather(-1, worst).clamp_min(1e-9)
            # Along axes that the constraint does not include, `away` is zero and the force is unchanged.
            safe = torch.where(excess > 0.0, safe - shrink * _pick(away, worst), safe)
            safe = torch.clamp(safe, -force_max, force_max)
        left = length((safe[..., None, :] - centre) * axes) - radius
        violated = left.amax(-1, keepdim=True)
        nearest = h.argmin(-1, keepdim=True)
        held = axes[nearest[..., 0]]
        # Brake to the speed at which h recovers: after braking to rest, a current would press the vehicle in.
        recovery = (-h.gather(-1, nearest)).clamp_min(0.0) / (RECOVERY_STEPS * dt)
        error = _pick(nu, nearest) - recovery * _pick(n, nearest)
        speed = length(error)[..., None]
        # At most the force that reaches this speed within the step; more would throw the vehicle back.
        brake = (self.mass_lower_kg * speed / dt).clamp_max(self.brake_force_N)
        braking = torch.where(held > 0.0, -brake * error / speed.clamp_min(1e-9), force)
        return torch.where(violated > 0.5, braking, safe)


def obstacle_neighbours(observation: Observation, vehicle_radius: float) -> Neighbours:
    """Obstacles that the vehicles detect, with the clearance between hulls."""
    obstacles, psi = observation.obstacles, observation.eta[..., 3, None]
    # Each vehicle has its own detected obstacles: treat it as a world with one vehicle.
    offset = obstacles.offset(observation.position[..., None, :], observation.time[:, None])[..., 0, :, :]
    l = length(offset)
    gap = torch.where(obstacles.present, l, torch.inf) - obstacles.radius - vehicle_radius
    n = offset / l[..., None].clamp_min(1e-9)
    relative = observation.nu[..., None, :2] - turned_to_body(obstacles.velocity, psi)
    axes = (torch.arange(3, device=offset.device) < 2).to(offset.dtype).expand(obstacles.number, 3)
    return Neighbours(_lift(turned_to_body(n, psi)), _lift(relative), gap, axes)


def vehicle_neighbours(observation: Observation) -> Neighbours:
    """The other vehicles of the same world, with the distance between centres; none is its own neighbour."""
    position = observation.position
    offset = position[..., :, None, :] - observation.messages.eta[..., :3]
    distance = length(offset)
    itself = torch.eye(position.shape[-2], dtype=torch.bool, device=position.device)
    n = offset / distance[..., None].clamp_min(1e-9)
    turned = turned_to_body(n, observation.eta[..., 3, None])
    nu = observation.nu[..., None, :3].expand_as(turned)
    return Neighbours(turned, nu, distance.masked_fill(itself, torch.inf), torch.ones_like(offset[0, 0, :, :]))


def _lift(horizontal: Tensor) -> Tensor:
    """Vectors [..., 2] as [..., 3], with zero along the third axis."""
    return torch.nn.functional.pad(horizontal, (0, 1))


def _pick(vectors: Tensor, index: Tensor) -> Tensor:
    """Vectors [..., 3] selected from [..., C, 3] by an index [..., 1]."""
    return vectors.gather(-2, index[..., None].expand(*index.shape, 3))[..., 0, :]
