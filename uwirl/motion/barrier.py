"""safety=barrier: the second-order control barrier function, an exact quadratic program of two forces.

With h = l - rho - r_v - margin for an obstacle and d - separation for another vehicle, n the unit vector towards the
own vehicle and v_t the relative speed across n,

    h'' + k_1 h' + k_0 h >= 0,   h'' = n . a + v_t^2 / l,   a = tau / m

is a half-plane of surge and sway forces. Two vehicles share the bound between them; heave is not changed. Unlike the
energy guard, this needs the vehicle's inertia; it neglects drag. At most two half-planes or limits hold with equality
at the optimum, so that an enumeration of all pairs is exact. (Wang, Ames, Egerstedt: "Safety barrier certificates for
collisions-free multirobot systems", IEEE Transactions on Robotics 33, 2017.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.safety import Limits, nothing_near, obstacle_neighbours, vehicle_neighbours
from uwirl.world.geometry import turned_to_body, turned_to_inertial, vector
from uwirl.world.observation import Observation


@dataclass(frozen=True)
class BarrierGuard:
    """safety=barrier.

    Attributes:
        limits: of the vehicle.
        margin_m: clearance to keep from obstacles, m.
        separation_m: distance to keep between the centres of vehicles, m.
        k_1: 1/s.
        k_0: 1/s^2.
        inertia_kg: assumed inertia in surge, sway and heave.
    """

    limits: Limits
    margin_m: float = 0.15
    separation_m: float = 1.0
    k_1: float = 2.0
    k_0: float = 1.0
    inertia_kg: Sequence[float] = (17.0, 24.2, 26.07)

    def __call__(self, tau: Tensor, observation: Observation) -> Tensor:
        """tau [B, M, 4], with the smallest change of surge and sway that satisfies the barriers."""
        if nothing_near(observation):
            return tau
        tau = torch.clamp(tau, -self.limits.tau_max, self.limits.tau_max)
        planes = []
        if observation.obstacles.number:
            planes.append(self._obstacles(observation))
        if observation.eta.shape[-2] > 1:
            planes.append(self._vehicles(observation, tau))
        normal, least = (torch.cat(parts, dim) for parts, dim in zip(zip(*planes, strict=True), (-2, -1), strict=True))
        return torch.cat([nearest_force(tau[..., :2], normal, least, self.limits.tau_max[:2]), tau[..., 2:]], -1)

    def _obstacles(self, observation: Observation) -> tuple[Tensor, Tensor]:
        near = obstacle_neighbours(observation, self.limits.vehicle_radius)
        l = near.clearance + self.limits.vehicle_radius + observation.obstacles.radius
        least = self._least(near.n, near.nu, near.clearance - self.margin_m, l)
        return near.n[..., :2] / self._inertia(near.n)[:2], least

    def _vehicles(self, observation: Observation, tau: Tensor) -> tuple[Tensor, Tensor]:
        near = vehicle_neighbours(observation)
        # Relative velocities, in the body axes of the vehicle that is protected.
        psi, others = observation.eta[..., 3], observation.messages
        own = turned_to_inertial(observation.nu[..., :3], psi)[..., :, None, :]
        theirs = turned_to_inertial(others.nu[..., :3], others.eta[..., 3])
        relative = turned_to_body(own - theirs, psi[..., None])
        least = 0.5 * self._least(near.n, relative, near.clearance - self.separation_m, near.clearance)
        inertia = self._inertia(near.n)
        return near.n[..., :2] / inertia[:2], least - near.n[..., 2] * tau[..., 2, None] / inertia[2]

    def _inertia(self, like: Tensor) -> Tensor:
        return vector(self.inertia_kg, like)

    def _least(self, n: Tensor, nu: Tensor, h: Tensor, l: Tensor) -> Tensor:
        """Least admissible n . a, [..., C]; minus infinity where there is no obstacle or vehicle."""
        rate = (n * nu).sum(-1)
        across = nu.square().sum(-1) - rate.square()
        return -self.k_1 * rate - self.k_0 * h - across.clamp_min(0.0) / l


def nearest_force(wanted: Tensor, normal: Tensor, least: Tensor, force_max: Tensor) -> Tensor:
    """The force nearest to the wanted one with normal . force >= least and |force| <= force_max.

    Args:
        wanted: [..., 2], N.
        normal: [..., C, 2].
        least: [..., C]; minus infinity where there is no constraint.
        force_max: [2], N.

    Returns:
        [..., 2], N, within the limits; if none is admissible, the candidate with the smallest violation.
    """
    size = torch.linalg.vector_norm(normal, dim=-1).clamp_min(1e-12)
    # In place of a missing constraint, one that always holds.
    b = torch.where(least.isfinite(), least / size, -10.0 * force_max.sum())
    sides = torch.eye(2, dtype=wanted.dtype, device=wanted.device)
    box = torch.cat([sides, -sides])
    A = torch.cat([normal / size[..., None], box.expand(*normal.shape[:-2], 4, 2)], -2)
    b = torch.cat([b, -force_max.repeat(2).expand(*b.shape[:-1], 4)], -1)
    lacking = (b - (A * wanted[..., None, :]).sum(-1)).clamp_min(0.0)
    one = wanted[..., None, :] + lacking[..., None] * A
    i, j = torch.triu_indices(b.shape[-1], b.shape[-1], 1, device=b.device)
    (a1, a2), (b1, b2) = (A[..., i, :], A[..., j, :]), (b[..., i], b[..., j])
    det = a1[..., 0] * a2[..., 1] - a1[..., 1] * a2[..., 0]
    det = torch.where(det.abs() < 1e-6, torch.inf, det)
    two = torch.stack([b1 * a2[..., 1] - b2 * a1[..., 1], a1[..., 0] * b2 - a2[..., 0] * b1], -1) / det[..., None]
    candidates = torch.cat([wanted[..., None, :], one, two], -2)
    violation = (b[..., None, :] - (A[..., None, :, :] * candidates[..., :, None, :]).sum(-1)).clamp_min(0.0)
    admissible = (violation < 1e-6).all(-1)
    within = (violation[..., -4:] < 1e-6).all(-1)
    change = torch.linalg.vector_norm(candidates - wanted[..., None, :], dim=-1)
    # Admissible candidates are ranked by their change, others by their violation.
    score = torch.where(admissible, change, 1e6 + violation[..., :-4].amax(-1))
    best = torch.where(within, score, torch.inf).argmin(-1)
    force = candidates.gather(-2, best[..., None, None].expand(*best.shape, 1, 2))[..., 0, :]
    return torch.maximum(torch.minimum(force, force_max), -force_max)
