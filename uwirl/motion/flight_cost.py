"""J of planned flights, and its derivatives: the running cost (37) with its edges rounded, guard and tail included.

    J = sum_k w_k [E_L + E_O + yaw term + 50 max(0, 0.1 m - h)^2] + sum_k dt sum_a R_a (tau_a - tau_trim,a)^2

with trapezoidal weights w_k, and at the last node a tail that counts its cost for a while longer: plans end at rest at
their goal. h is the guard's barrier: where it is small the guard would change the flight. All Hessians are positive
semidefinite: what curves the other way is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from uwirl.motion.avoidance import Avoidance
from uwirl.motion.cost import RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.geometry import length, turned_to_inertial
from uwirl.world.obstacles import Obstacles

# Weight of the barrier's penalty, 1/m^2, and the h below which it acts, m.
GUARD_WEIGHT, GUARD_H = 50.0, 0.1
# For how long the last node's cost goes on, s.
TAIL = 80.0
# Length over which the worse link's edge, where both hops are equal, is rounded, m.
RIDGE = 0.2


@dataclass(frozen=True)
class FlightCost:
    """The cost of K flights on nodes dt apart.

    Attributes:
        cost: RelayCost of the K vehicles.
        frame: their link frames, [K].
        obstacles: those that each vehicle knows, fields [K, O(, 2)].
        begin: time at the first node, [K], s.
        dt: s.
        clearance: least distance between a vehicle's centre and an obstacle's surface, m.
        braking: braking distance for a squared speed of 1 (m/s)^2, s^2/m.
        ridge: see RIDGE.
    """

    cost: RelayCost
    frame: LinkFrame
    obstacles: Obstacles
    begin: Tensor
    dt: float
    clearance: float
    braking: float
    ridge: float = RIDGE

    def select(self, rows: Tensor) -> FlightCost:
        """The cost of some flights, by their numbers."""
        frame = LinkFrame(self.frame.target[rows], self.frame.bearing[rows])
        obstacles = self.obstacles.worlds(rows)
        return replace(self, cost=self.cost.of(rows), frame=frame, obstacles=obstacles, begin=self.begin[rows])

    @property
    def nodes(self) -> Tensor:
        """Positions of both neighbours, inertial, [K, 2, 3], m."""
        return self.frame.target[:, None] + turned_to_inertial(self.cost.neighbours, self.frame.bearing[:, None])

    def weights(self, nodes: int, like: Tensor) -> Tensor:
        """Weights of the running cost at N + 1 nodes, [N + 1], s."""
        w = like.new_full((nodes,), self.dt)
        w[0], w[-1] = 0.5 * self.dt, 0.5 * self.dt + TAIL
        return w

    def total(self, x: Tensor, effort: Tensor) -> Tensor:
        """J of flights x [N + 1, ..., K, 8] with effort [N, ..., K, 4], [..., K]."""
        hop = self._hop(x[..., :3])[0]
        q = self._link(hop) + self.cost.weights.yaw_weight * (1.0 - torch.cos(x[..., 3] - self.frame.bearing))
        if self.obstacles.number:
            l = self._offset(x)[1]
            q = q + self.cost.weights.beta_2 * self._avoidance(l)
            q = q + GUARD_WEIGHT * (GUARD_H - self._barrier(l, x)).clamp_min(0.0).square().sum(-1)
        return torch.tensordot(self.weights(len(x), x), q, 1) + self.dt * self.cost.control(effort).sum(0)

    def rate_at(self, places: Tensor) -> Tensor:
        """Cost rate of staying at places [K, P, 3] at the first node's time, without the yaw term, [K, P]."""
        one = self.select(torch.arange(len(places), device=places.device).repeat_interleave(places.shape[1]))
        x = torch.nn.functional.pad(places.flatten(0, 1), (0, 5))[None]
        q = one._link(one._hop(x[..., :3])[0])
        if self.obstacles.number:
            q = q + self.cost.weights.beta_2 * one._avoidance(one._offset(x)[1])
        return q.view(places.shape[:-1])

    def gap(self, x: Tensor) -> Tensor:
        """Smallest clearance of flights x [N + 1, K, 8] less the one to keep, [K], m; infinite in free water."""
        if not self.obstacles.number:
            return x.new_full((x.shape[1],), torch.inf)
        return (self._offset(x)[1] - self.obstacles.radius).amin((0, -1)) - self.clearance

    def expanded(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Gradient [N + 1, K, 8] and Hessian [N + 1, K, 8, 8] of J by the nodes x [N + 1, K, 8]."""
        g, H = torch.zeros_like(x), x.new_zeros(*x.shape, 8)
        hop, slope, curvature = self._hop(x[..., :3])
        first, second = _derivatives(self._link, hop)
        g[..., :3] = first[..., None] * slope
        H[..., :3, :3] = second[..., None, None] * _outer(slope) + first[..., None, None] * curvature
        off = x[..., 3] - self.frame.bearing
        g[..., 3] = self.cost.weights.yaw_weight * torch.sin(off)
        H[..., 3, 3] = self.cost.weights.yaw_weight * torch.cos(off).clamp_min(0.1)
        if self.obstacles.number:
            self._expand_obstacles(x, g, H)
        w = self.weights(len(x), x)
        return w[:, None, None] * g, w[:, None, None, None] * H

    def _expand_obstacles(self, x: Tensor, g: Tensor, H: Tensor) -> None:
        """Add the terms of obstacles to gradients and Hessians."""
        away, l = self._offset(x)
        first, second = _derivatives(self._avoidance, l)
        g[..., :2] += self.cost.weights.beta_2 * (first[..., None] * away).sum(-2)
        H[..., :2, :2] += self.cost.weights.beta_2 * (second[..., None, None] * _outer(away)).sum(-3)
        lack = (GUARD_H - self._barrier(l, x)).clamp_min(0.0)
        if not bool(lack.any()):
            return
        slope = x.new_zeros(*l.shape, 8)
        slope[..., :2] = away
        slope[..., 4:6] = -2.0 * self.braking * x[..., None, 4:6]
        g -= 2.0 * GUARD_WEIGHT * (lack[..., None] * slope).sum(-2)
        active = (lack > 0.0).to(x)[..., None]
        H += 2.0 * GUARD_WEIGHT * (active * slope).mT @ slope

    def _hop(self, position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The longer hop, rounded, [...], its gradient [..., 3] and Hessian [..., 3, 3], m, by the position."""
        offset = position[..., None, :] - self.nodes
        d = length(offset).clamp_min(1e-6)
        n = offset / d[..., None]
        gap = d[..., 0] - d[..., 1]
        round_ = torch.sqrt(gap.square() + self.ridge**2)
        share = torch.stack([0.5 + 0.5 * gap / round_, 0.5 - 0.5 * gap / round_], -1)
        difference = n[..., 0, :] - n[..., 1, :]
        flat = torch.eye(3, dtype=n.dtype, device=n.device) - _outer(n)
        curvature = ((share / d)[..., None, None] * flat).sum(-3)
        curvature = curvature + (0.5 * self.ridge**2 / round_**3)[..., None, None] * _outer(difference)
        return 0.5 * (d.sum(-1) + round_), (share[..., None] * n).sum(-2), curvature

    def _link(self, hop: Tensor) -> Tensor:
        """E_L minus its minimum at a hop [..., K], m."""
        return self.cost.weights.beta_1 / self.cost.channel.mean_capacity_kbps(hop).square() - self.cost.minimum

    def _offset(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Unit vectors from the obstacles' axes [..., K, O, 2] and distances to them [..., K, O], m."""
        time = self.begin + self.dt * torch.arange(len(x), dtype=x.dtype, device=x.device).view(-1, *[1] * (x.ndim - 2))
        centre = self.obstacles.centre + self.obstacles.velocity * time[..., None, None]
        offset = x[..., None, :2] - centre
        l = length(offset).clamp_min(1e-6)
        present = self.obstacles.present
        return torch.where(present[..., None], offset / l[..., None], 0.0), torch.where(present, l, 1e6)

    def _avoidance(self, l: Tensor) -> Tensor:
        # Within an obstacle the term would have no bound.
        avoidance: Avoidance = self.cost.weights.avoidance
        return avoidance(torch.maximum(l, self.obstacles.radius), self.obstacles.influence)

    def _barrier(self, l: Tensor, x: Tensor) -> Tensor:
        """h [..., K, O] at distances l from the axes, m."""
        return l - self.obstacles.radius - self.clearance - self.braking * x[..., 4:6].square().sum(-1, keepdim=True)


def _outer(vector: Tensor) -> Tensor:
    return vector[..., :, None] * vector[..., None, :]


def _derivatives(function: object, at: Tensor) -> tuple[Tensor, Tensor]:
    """First and second derivative, the latter not below zero, of a sum of functions of single elements."""
    with torch.enable_grad():
        leaf = at.detach().requires_grad_()
        (first,) = torch.autograd.grad(function(leaf).sum(), leaf, create_graph=True)  # type: ignore[operator]
        (second,) = torch.autograd.grad(first.sum(), leaf)
    return first.detach(), second.clamp_min(0.0)
