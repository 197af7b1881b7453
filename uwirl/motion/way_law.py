"""The control law along a route: speed, heading, depth, keeping right, and the force against a current.

Minimising (q + R F^2) / v along the route gives the force F = k sqrt(q / R_b), R_b = sum_k R_k u_bk^2 with u_b the
route's direction in body axes. With quadratic drag R_b F^2 = q / 3, k = 0.577; with linear drag R_b F^2 = q, k = 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import length, to_body, turned_to_inertial, unit, wrapped
from uwirl.world.vehicle import Moving


class OnWay(NamedTuple):
    """Vehicles on their routes.

    Attributes:
        state: [B, M].
        way: directions of the routes, unit vectors, [B, M, 2]; zero at the goal.
        goal: [B, M, 3], m.
        distance: from the goal, horizontal, [B, M], m.
        bearing: of the links, [B, M], rad.
        link: link cost, [B, M].
        q: cost rate minus that of the goal, [B, M].
    """

    state: Moving
    way: Tensor
    goal: Tensor
    distance: Tensor
    bearing: Tensor
    link: Tensor
    q: Tensor


@dataclass(frozen=True)
class WayLaw:
    """The control law along a route. Its constants were tuned with `bluerov2` in the layouts of docs/safety.md.

    Attributes:
        near_m: within this distance of the goal only the policy for the last metres acts, because the map is too coarse
            there, m.
        far_m: beyond this distance only the route is followed; in between both are blended, m.
        pace_floor: smallest q used for the speed; without it the last metres would take too long.
        pace_floor_m: within this distance of the goal the floor decreases, so that the vehicle does not overshoot, m.
        keep_right_m: distance between vehicles at which they begin to turn right: two vehicles that meet need twice
            their braking distance, m.
        heading_speed_mps: speed above which the Munk moment decides the heading, not the cost's bearing, m/s.
        heading_clip_rad: heading errors are clipped to this value: a faster turn costs more than it gains, rad.
        turning: weight of turning by an angle, relative to a heading that differs from the link's by this angle.
        pace_drag: a force F is expected to give the speed sqrt(F / pace_drag), by quadratic drag, N s^2/m^2.
        glide: remaining fraction of the depth = (remaining fraction of the distance) ^ glide, so that the depth is
            reached slightly before the goal.
        glide_damping: force per deviation from the vertical velocity of that path, N s/m.
        progress_mps: if the progress along the route is slower than this, the push against a current grows, m/s.
        progress_rate: rate at which it grows, N/m.
        forgetting: rate at which it decays when it is not needed, 1/s.
        integral_within_m: within this distance of the goal, its error is integrated instead of the progress, m.
        goal_rate: rate of that integration, N/s: slow, because this error needs only small corrections of the push.
        close_m: closer to the goal than this, nothing is integrated, m.
        still_mps: below this speed, a vehicle near the goal counts as stalled, m/s.
        push_N: largest push, half of the maximum thrust, N.
    """

    near_m: float = 1.0
    far_m: float = 3.0
    pace_floor: float = 0.004
    pace_floor_m: float = 2.0
    keep_right_m: float = 6.0
    heading_speed_mps: float = 0.6
    heading_clip_rad: float = 0.15
    turning: float = 0.5
    pace_drag: float = 20.0
    glide: float = 1.3
    glide_damping: float = 20.0
    progress_mps: float = 0.35
    progress_rate: float = 8.0
    forgetting: float = 0.02
    integral_within_m: float = 2.0
    goal_rate: float = 2.4
    close_m: float = 0.05
    still_mps: float = 0.05
    push_N: float = 40.0

    def near_share(self, distance: Tensor) -> Tensor:
        """Weight of the policy for the last metres, 0 to 1, at a distance from the goal in m."""
        return ((self.far_m - distance) / (self.far_m - self.near_m)).clamp(0.0, 1.0)

    def pace_cost(self, q: Tensor, distance: Tensor, floor: Tensor | float | None = None) -> Tensor:
        """The q that sets the speed, from a place's q minus that of the goal, and its distance from the goal, m.

        `floor` stands for `pace_floor` if given.
        """
        least = self.pace_floor if floor is None else floor
        return torch.maximum(q, least * (distance / self.pace_floor_m).square().clamp_max(1.0))

    def drive(self, q: Tensor, R: Tensor, u: Tensor) -> Tensor:
        """sqrt(q / R_b), [...], N: the force along a route u_b [..., 2] for k = 1, before `slowed`.

        Args:
            q: see `pace_cost`, [...].
            R: control weights of surge and sway, [2].
            u: unit vectors in body axes, [..., 2]; zero at the goal.
        """
        effort = (R * u.square()).sum(-1).clamp_min(torch.finfo(u.dtype).tiny)
        return torch.sqrt(q / effort)

    def slowed(self, drive: Tensor, u: Tensor) -> Tensor:
        """Drive [...] along routes u_b [..., 2], reduced at oblique angles a: the Munk moment grows with sin 2a."""
        return drive / (1.0 + (2.0 * u[..., 0] * u[..., 1]).square())

    def keep_right(self, way: Tensor, position: Tensor, others: Tensor) -> Tensor:
        """Routes that turn right of vehicles ahead; otherwise two that meet head-on would stop each other.

        Args:
            way: unit vectors, [..., M, 2]; zero at the goal.
            position: [..., M, 3], m.
            others: positions of the others as known to each vehicle, [..., M, M, 3], m.
        """
        if way.shape[-2] == 1:
            return way
        offset = others - position[..., :, None, :]
        close = ((self.keep_right_m - length(offset)) / self.keep_right_m).clamp_min(0.0)
        towards = unit(offset[..., :2])
        right = torch.stack([towards[..., 1], -towards[..., 0]], -1)
        ahead = (way[..., None, :] * towards).sum(-1).clamp_min(0.0)
        turned = way + ((close * ahead)[..., None] * (right - towards)).sum(-2)
        return unit(turned)

    def heading_error(self, way: Tensor, state: Moving, bearing: Tensor, drive: Tensor) -> Tensor:
        """Difference between the heading and the best heading, [B, M], rad, clipped to avoid fast turns.

        The cost prefers the link's bearing. At speed V, the Munk moment (m_v - m_u) V^2 sin(2 a) / 2, with a the angle
        between bow and route, costs yaw thrust; it prefers headings with bow, stern or a side along the route. In the
        sum of both squares, such a heading has the weight V^4 / (V^4 + V_0^4). Among bow, stern and sides, the one
        nearest to the bearing and to the present heading is chosen, so that the vehicle does not turn back and forth.
        V is the larger of the speed and the speed expected from the drive: turning is cheap while the vehicle is slow.

        Args:
            way: unit vectors, [B, M, 2].
            state: [B, M].
            bearing: of the links, [B, M] or [M], rad.
            drive: force along the route, [B, M], N.
        """
        off = wrapped(state.eta[..., 3] - bearing)
        # Bow or stern: modulo pi. atan2 depends in its last digit on the size of the batch.
        x, y = way.unbind(-1)
        ends = wrapped(torch.atan(y / torch.where(x == 0.0, torch.finfo(x.dtype).tiny, x)) - bearing, math.pi)
        sides = ends - torch.where(ends > 0.0, math.pi / 2.0, -math.pi / 2.0)
        price_ends, price_sides = (turn.abs() + self.turning * wrapped(off - turn).abs() for turn in (ends, sides))
        fourth = torch.maximum(state.nu[..., :2].square().sum(-1), drive / self.pace_drag).square()
        best = fourth / (fourth + self.heading_speed_mps**4) * torch.where(price_sides < price_ends, sides, ends)
        return wrapped(off - best).clamp(-self.heading_clip_rad, self.heading_clip_rad)

    def descent(self, state: Moving, goal: Tensor, distance: Tensor) -> Tensor:
        """Heave in addition to the trim, [B, M], N, for the glide path to goals [B, M, 3]: faster gains nothing."""
        error = state.position[..., 2] - goal[..., 2]
        speed = length(state.nu[..., :2])
        return -self.glide_damping * (state.nu[..., 2] + self.glide * error * speed / distance.clamp_min(self.near_m))

    def pushed(
        self,
        push: Tensor,
        state: Moving,
        goal: Tensor,
        way: Tensor,
        distance: Tensor,
        dt: float,
        progress: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """The push against a current: the integral of missing progress or, near the goal, of the error to the goal.

        Args:
            push: present push, in the inertial frame like a current, [B, M, 2], N.
            state: [B, M].
            goal: [B, M, 3], m.
            way: unit vectors, [B, M, 2].
            distance: from the goal, [B, M], m.
            dt: s.
            progress: speed along the route below which the push grows, [B, M], m/s; `progress_mps` if None.

        Returns:
            Surge and sway [B, M, 2], N, and the push after dt.
        """
        velocity = turned_to_inertial(state.nu[..., :2], state.eta[..., 3])
        error = state.position[..., :2] - goal[..., :2]
        least = torch.full_like(distance, self.progress_mps) if progress is None else progress
        slow = ((velocity * way).sum(-1) < least)[..., None]
        on_way = self.progress_rate * slow * (least[..., None] * way - velocity)
        still = 1.0 + velocity.square().sum(-1, keepdim=True) / self.still_mps**2
        beyond = (1.0 - self.close_m / distance.clamp_min(self.close_m))[..., None]
        at_goal = -self.goal_rate * beyond * error / (1.0 + distance[..., None]) / still
        rate = torch.where((distance > self.integral_within_m)[..., None], on_way, at_goal)
        push = (push + dt * (rate - self.forgetting * push)).clamp(-self.push_N, self.push_N)
        return torch.stack(to_body(push[..., 0], push[..., 1], state.eta[..., 3]), -1), push
