"""The law along a route for a vehicle whose model is known or learned: optimal speed, heading, depth and turning.

On a long straight route whose cost rate q changes slowly, a vehicle that has the angle a to it and the speed v pays

    h(a) = min_v (q + tau' R tau) / v        for each metre, tau the forces that a steady flight takes by the model.

The value falls by h for each metre. The Hamilton-Jacobi-Bellman equation then gives the force at any other speed,

    f(v) = d(v) +- sqrt((q + d(v)' R d(v) - h v) / R_b),

with d the drag, + below the best speed and - above. R_b = sum_k R_k u_bk^2 weighs a force along the route, u_b its unit
vector in body axes. At rest f = sqrt(q / R_b), whatever the drag. Depth follows the same rule with the part of q
that is due to depth. The heading is the one of the least h; its stiffness and damping are those of the linear-quadratic
regulator of the yaw axis, with the curvature of h v as its weight. The constants below belong to no vehicle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.cost import RelayCost
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.route import link_cost
from uwirl.motion.vehicle_model import Fossen, VehicleModel
from uwirl.motion.way_law import OnWay, WayLaw
from uwirl.world.geometry import left_of, to_body, turned_to_body, wrapped

# Angles between bow and route that are compared, speeds in m/s, and cost rates relative to a capacity lost.
ANGLES = 48
SPEEDS, SLOWEST, FASTEST = 240, 0.005, 3.0
LEVELS, LEAST, MOST = 96, 1e-6, 10.0
# Share of the thruster limits that steady flight may use.
USABLE = 0.9
# Cost rates below that of 1 % of capacity matter no more: the vehicle may take its time.
CAPACITY_SHARE = 0.02
# Time of a turn, by which turns are priced against what a better heading saves, s.
TURN_S = 3.0
# Share of the curvature of h v that heading errors weigh: the rest is due to the Munk moment, which is cancelled.
CURVATURE = 0.25
# Times in which velocity across the route and vertical velocity are corrected, s; a heading control held over dt
# has at most the frequency STIFFEST / dt.
ACROSS_S, DEPTH_S, STIFFEST = 0.25, 3.3, 0.6
# Depths closer than this to the goal's are approached in proportion, m.
CLOSE_M = 0.2
# A vehicle slower than this share of its best speed is held back by something that the model lacks.
HELD_BACK = 0.5
# Rates of the push against it, of inertia, 1/s^2.
PUSH_ON_WAY, PUSH_AT_GOAL = 0.5, 0.14
# Rate of turns that are slow, rad/s.
SLOW_TURN = 1e-3
# Full thrust is taken to give this speed while nothing is known, m/s and rad/s.
DECLARED_SPEED, DECLARED_RATE = 1.0, 2.0


class Pace(NamedTuple):
    """Cost per metre and best speed over cost rates, [levels, ...]."""

    per_metre: Tensor
    speed: Tensor

    @classmethod
    def of(cls, drag_cost: Tensor, speeds: Tensor) -> Pace:
        """From the cost of steady flight [..., speeds] at speeds [speeds]."""
        q = _levels(speeds)[(...,) + (None,) * drag_cost.ndim]
        per_metre, best = ((q + drag_cost) / speeds).min(-1)
        return cls(per_metre, speeds[best])

    def at(self, field: Tensor, q: Tensor, *index: Tensor) -> Tensor:
        """A field at cost rates q [...], and at an index of each other dimension."""
        level = (q.clamp(LEAST, MOST).log() - math.log(LEAST)) * ((LEVELS - 1) / math.log(MOST / LEAST))
        below = level.long().clamp(0, LEVELS - 2)
        return torch.lerp(field[below, *index], field[below + 1, *index], level - below)


def _levels(like: Tensor) -> Tensor:
    return torch.logspace(math.log10(LEAST), math.log10(MOST), LEVELS, dtype=like.dtype, device=like.device)


@dataclass(frozen=True)
class Cruise:
    """Flies along routes by a model.

    Attributes:
        model: of one vehicle, [1].
        cost: running cost.
        tau_max: thruster limits, [4].
        dt: time for which a control is held, s.
    """

    model: VehicleModel
    cost: RelayCost
    tau_max: Tensor
    dt: float

    @cached_property
    def way(self) -> WayLaw:
        """What does not depend on the model, with pushes in proportion to inertia."""
        mass, strongest = float(self.inertia[0]), 0.5 * float(self.tau_max[:2].min())
        return WayLaw(progress_rate=PUSH_ON_WAY * mass, goal_rate=PUSH_AT_GOAL * mass, push_N=strongest)

    @cached_property
    def inertia(self) -> Tensor:
        """Diagonal of M, [4]."""
        return torch.linalg.inv(self.model.inverse_inertia)[0].diagonal().to(self.cost.R)

    @cached_property
    def yaw_damping(self) -> float:
        """Damping of slow turns, N m s/rad."""
        rates = self.inertia.new_tensor([[0.0, 0.0, 0.0, -SLOW_TURN], [0.0, 0.0, 0.0, SLOW_TURN]])
        before, after = self._forces(rates)[:, 3].tolist()
        return max((after - before) / (2.0 * SLOW_TURN), 0.0)

    @cached_property
    def speeds(self) -> Tensor:
        """Speeds that are compared, [speeds], m/s."""
        ends = math.log10(SLOWEST), math.log10(FASTEST)
        return torch.logspace(*ends, SPEEDS, dtype=self.cost.R.dtype, device=self.cost.R.device)

    @cached_property
    def angles(self) -> Tensor:
        """Angles of the route from the bow that are compared, [angles], rad."""
        steps = torch.arange(ANGLES, dtype=self.cost.R.dtype, device=self.cost.R.device)
        return steps * (2.0 * math.pi / ANGLES) - math.pi

    @cached_property
    def level(self) -> Pace:
        """Of flight along routes, [levels, angles]."""
        a = self.angles[:, None]
        nu = torch.stack([torch.cos(a) * self.speeds, torch.sin(a) * self.speeds], -1)
        return Pace.of(self._steady(torch.nn.functional.pad(nu, (0, 2))), self.speeds)

    @cached_property
    def vertical(self) -> Pace:
        """Of diving and rising, [levels]."""
        return Pace.of(self._steady(torch.nn.functional.pad(self.speeds[:, None], (2, 1))), self.speeds)

    @cached_property
    def turning(self) -> Tensor:
        """Cost of turns by 0 to 180 degrees in TURN_S, [angles / 2 + 1]."""
        turn = torch.linspace(0.0, math.pi, ANGLES // 2 + 1).to(self.cost.R)
        drag = self._forces(torch.nn.functional.pad((turn / TURN_S)[:, None], (3, 0)))[:, 3]
        spun = 12.0 * (self.inertia[3] * turn).square() / TURN_S**3
        return self.cost.R[3] * (spun + TURN_S * drag.square())

    def _forces(self, nu: Tensor) -> Tensor:
        """Forces of steady flight at nu [..., 4] through the water."""
        return (self.model.forces(nu[..., None, :].double()) - self.model.trim)[..., 0, :].to(nu)

    def _steady(self, nu: Tensor) -> Tensor:
        """tau' R tau of steady flight; infinite beyond the thruster limits."""
        tau = self._forces(nu)
        within = (tau.abs() < USABLE * self.tau_max.to(tau)).all(-1)
        return torch.where(within, self.cost.control(tau), torch.inf)

    def control(self, seen: OnWay, near: LinkController) -> tuple[Tensor, Tensor]:
        """tau [B, M, 4], and the speed along the route below which a vehicle is held back, [B, M].

        Args:
            seen: vehicles on their routes.
            near: tells the trim, and the frames in which depth costs.
        """
        psi, nu = seen.state.eta[..., 3], seen.state.nu
        least = CAPACITY_SHARE * self.cost.minimum.to(psi)
        q = self.way.pace_cost(seen.q, seen.distance, least)
        Q = q + self.cost.weights.yaw_weight * (1.0 - torch.cos(psi - seen.bearing))
        u = torch.stack(to_body(seen.way[..., 0], seen.way[..., 1], psi), -1)
        speed, sinking = self._speed(Q, u), self._sinking(seen, near, least)
        ahead = (nu[..., :2] * u).sum(-1)
        best = torch.cat([speed[..., None] * u, sinking[..., None]], -1)
        # The drag across the route damps, so it is not made up for.
        along = torch.cat([ahead[..., None] * u, nu[..., 2:3]], -1)
        wanted, now, turned = self._drag(torch.stack([best, along, nu[..., :3]], -2), psi)
        push = self._push(Q, speed, ahead, wanted, now, u)[..., None] * u
        across = left_of(u)
        drift = (nu[..., :2] * across).sum(-1, keepdim=True) * across * self.inertia[:2] / ACROSS_S
        heave = wanted[..., 2] + self.inertia[2] / DEPTH_S * (sinking - nu[..., 2])
        heading, curvature = self._heading(seen, q)
        yaw = turned[..., 3] + self._turn(wrapped(psi - heading), nu[..., 3], q, curvature * speed)
        effort = torch.cat([now[..., :2] + push - drift, heave[..., None], yaw[..., None]], -1)
        trim = near.trim.to(effort).expand(psi.numel(), 4).view(effort.shape)
        return trim + effort, HELD_BACK * speed

    def _drag(self, velocity: Tensor, psi: Tensor) -> tuple[Tensor, ...]:
        """Forces [..., 4] of steady flight without turning at K velocities over ground [..., K, 3], headings [...]."""
        nu = torch.nn.functional.pad(velocity, (0, 1))
        water = torch.nn.functional.pad(self.model.current[0].to(nu), (0, 2)).expand_as(nu)
        return self._forces(nu - turned_to_body(water, psi[..., None])).unbind(-2)

    def _speed(self, q: Tensor, u: Tensor) -> Tensor:
        """Best speed along routes u [..., 2] in body axes at cost rates [...], m/s."""
        place = (torch.atan2(u[..., 1], u[..., 0]) + math.pi) * (ANGLES / (2.0 * math.pi))
        left = place.long()
        low, high = (self.level.at(self.level.speed, q, k % ANGLES) for k in (left, left + 1))
        return torch.lerp(low, high, place - left)

    def _sinking(self, seen: OnWay, near: LinkController, least: Tensor) -> Tensor:
        """Best vertical velocity, [B, M], m/s."""
        error = seen.state.position[..., 2] - seen.goal[..., 2]
        level = torch.cat([seen.state.position[..., :2], seen.goal[..., 2:]], -1)
        q = (seen.link - link_cost(near.frame, self.cost, level).to(level)).clamp_min(0.0)
        speed = self.vertical.at(self.vertical.speed, self.way.pace_cost(q, error.abs(), least))
        return -speed * (error / CLOSE_M).clamp(-1.0, 1.0)

    def _push(self, q: Tensor, speed: Tensor, along: Tensor, wanted: Tensor, now: Tensor, u: Tensor) -> Tensor:
        """f - d, [B, M], N: what accelerates or brakes a vehicle of this speed along its route."""
        paid, pays = (self.cost.control(drag) - self.cost.R[2] * drag[..., 2].square() for drag in (wanted, now))
        excess = q + pays - (q + paid) / speed * along
        effort = (self.cost.R[:2] * u.square()).sum(-1).clamp_min(torch.finfo(u.dtype).tiny)
        return torch.sign(speed - along) * torch.sqrt(excess.clamp_min(0.0) / effort)

    def _heading(self, seen: OnWay, q: Tensor) -> tuple[Tensor, Tensor]:
        """Best heading, rad, and the curvature of its cost per metre, [B, M]."""
        bearing = torch.atan2(seen.way[..., 1], seen.way[..., 0])
        psi = bearing[..., None] - self.angles
        Q = q[..., None] + self.cost.weights.yaw_weight * (1.0 - torch.cos(psi - seen.bearing[..., None]))
        turn = wrapped(psi - seen.state.eta[..., 3:]).abs() * (ANGLES / (2.0 * math.pi))
        far = seen.distance[..., None].clamp_min(1.0)
        each = torch.arange(ANGLES, device=psi.device).expand(psi.shape)
        low = turn.long().clamp_max(ANGLES // 2 - 1)
        turned = torch.lerp(self.turning[low], self.turning[low + 1], turn - low)
        price = self.level.at(self.level.per_metre, Q, each) + turned / far
        best = price.argmin(-1, keepdim=True)
        before, least, after = (price.gather(-1, (best + k) % ANGLES)[..., 0] for k in (-1, 0, 1))
        step = 2.0 * math.pi / ANGLES
        curvature = (before - 2.0 * least + after).clamp_min(torch.finfo(price.dtype).tiny)
        angle = self.angles[best[..., 0]] + step * (0.5 * (before - after) / curvature).clamp(-0.5, 0.5)
        return bearing - angle, curvature / step**2

    def _turn(self, error: Tensor, rate: Tensor, q: Tensor, curvature: Tensor) -> Tensor:
        """Moment that brings the heading to the best one, at most as dear as the cost rate, [B, M]."""
        price, inertia = self.cost.R[3], self.inertia[3]
        weight = 0.5 * (self.cost.weights.yaw_weight + CURVATURE * curvature)
        stiffness = torch.sqrt(weight / price).clamp_max(STIFFEST**2 * inertia / self.dt**2)
        damping = torch.sqrt(self.yaw_damping**2 + 2.0 * inertia * stiffness) - self.yaw_damping
        most = torch.sqrt((q + self.cost.weights.yaw_weight) / price)
        pull = torch.maximum(torch.minimum(stiffness * error, most), -most)
        return -pull - damping.clamp_max(0.5 * inertia / self.dt) * rate


def declared_model(inertia: Tensor, tau_max: Tensor) -> VehicleModel:
    """What is assumed of a vehicle before its first flight.

    Args:
        inertia: declared lower bound of each axis' inertia, [4].
        tau_max: thruster limits, [4].
    """
    speed = tau_max.new_tensor([DECLARED_SPEED] * 3 + [DECLARED_RATE])
    theta = torch.cat([inertia.to(tau_max), torch.zeros_like(tau_max), tau_max / speed.square(), tau_max.new_zeros(1)])
    return VehicleModel(Fossen(), theta[None].double(), tau_max.new_zeros(1, 2).double())
