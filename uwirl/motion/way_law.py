"""How a vehicle follows its way: pace, heading, depth, giving way, and the push against a current.

Minimising (q + R F^2) / v along the way gives the force F = k sqrt(q / R_b), R_b = sum_k R_k u_bk^2 with u_b the way's
direction in body axes: R_b F^2 = q / 3, k = 0.577, where drag is quadratic, R_b F^2 = q, k = 1, where it is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.geometry import to_body, turned_to_inertial, wrapped
from uwirl.world.vehicle import Moving


@dataclass(frozen=True)
class WayLaw:
    """The law along the way. Its constants were found on `bluerov2` in the layouts of docs/safety.md.

    Attributes:
        near_m: within this distance of the goal the led policy acts alone, m: the map's last cells are too coarse.
        far_m: beyond this distance the way alone, in between a blend, m.
        pace_floor: least q that sets the pace, or the last metres would take for ever.
        pace_floor_m: distance from the goal within which that floor shrinks, lest the vehicle overshoot, m.
        keep_right_m: distance between vehicles at which they begin to give way: two that meet need the length in which
            they brake, twice, m.
        heading_speed_mps: speed above which the Munk moment decides the heading, not the cost's bearing, m/s.
        heading_clip_rad: largest heading error that is answered: a quicker turn costs more than it gains, rad.
        turning: what turning by an angle counts against holding a heading that is off the link's by as much.
        pace_drag: a drive F aims at the speed sqrt(F / pace_drag): the quadratic drag at work, N s^2/m^2.
        glide: the share of the depth that is left is the share of the way that is left to this power, so that the depth
            is reached a little before the goal.
        glide_damping: force for a vertical velocity that is off that path, N s/m.
        progress_mps: progress along the way below which a push against a current grows, m/s.
        progress_rate: at which it grows, N/m.
        forgetting: at which it fades once it is not needed, 1/s.
        integral_within_m: distance of the goal within which its error is integrated instead of the progress, m.
        goal_rate: at which that is integrated, N/s: a slow one, since the error is small beside the push.
        close_m: what is close enough to the goal to be left alone, m.
        still_mps: speed below which a vehicle is stalled near the goal rather than on its way, m/s.
        push_N: largest push, half of what thrusters give, N.
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
        """Share of the policy for the last metres at a distance from the goal, m."""
        return ((self.far_m - distance) / (self.far_m - self.near_m)).clamp(0.0, 1.0)

    def pace_cost(self, q: Tensor, distance: Tensor) -> Tensor:
        """The q that sets the pace, of a place's q less that of the goal, and the distance from there, m."""
        return torch.maximum(q, self.pace_floor * (distance / self.pace_floor_m).square().clamp_max(1.0))

    def drive(self, q: Tensor, R: Tensor, u: Tensor) -> Tensor:
        """sqrt(q / R_b), [...], N: the force along a way u_b [..., 2] for a gain of one, before it is slowed.

        Args:
            q: see `pace_cost`, [...].
            R: control weights of surge and sway, [2].
            u: unit vectors in body axes, [..., 2]; at the goal itself there is none.
        """
        effort = (R * u.square()).sum(-1).clamp_min(torch.finfo(u.dtype).tiny)
        return torch.sqrt(q / effort)

    def slowed(self, drive: Tensor, u: Tensor) -> Tensor:
        """Drive [...] along ways u_b [..., 2], less where askew at an angle a: the Munk moment grows with sin 2a."""
        return drive / (1.0 + (2.0 * u[..., 0] * u[..., 1]).square())

    def keep_right(self, way: Tensor, position: Tensor, others: Tensor) -> Tensor:
        """Ways that turn right of other vehicles ahead, or two that meet head-on would brake each other to a stop.

        Args:
            way: unit vectors, [..., M, 2]; zero at the goal.
            position: [..., M, 3], m.
            others: where each vehicle knows the others to be, [..., M, M, 3], m.
        """
        offset = others - position[..., :, None, :]
        close = ((self.keep_right_m - torch.linalg.vector_norm(offset, dim=-1)) / self.keep_right_m).clamp_min(0.0)
        towards = torch.nn.functional.normalize(offset[..., :2], dim=-1)
        right = torch.stack([towards[..., 1], -towards[..., 0]], -1)
        ahead = (way[..., None, :] * towards).sum(-1).clamp_min(0.0)
        turned = way + ((close * ahead)[..., None] * (right - towards)).sum(-2)
        return torch.nn.functional.normalize(turned, dim=-1)

    def heading_error(self, way: Tensor, state: Moving, bearing: Tensor, drive: Tensor) -> Tensor:
        """How far the bow is off the best heading, [B, M], rad, clipped so that it is never turned in haste.

        The cost asks for the link's bearing; at speed V the Munk moment, which the yaw thruster pays for, asks for the
        bow, the stern or a side along the way: it is (m_v - m_u) V^2 sin(2 a) / 2 at an angle a to the way. Of the sum
        of both squares such a heading takes a share V^4 / (V^4 + V_0^4). It is bow or stern, or a side, whichever is
        nearer to the bearing, and to the present heading, lest the vehicle turn to and fro. V is the speed that the
        drive aims at, if that is more: turning is cheap as long as the vehicle is slow.

        Args:
            way: unit vectors, [B, M, 2].
            state: [B, M].
            bearing: of the links, [B, M] or [M], rad.
            drive: force along the way, [B, M], N.
        """
        off = wrapped(state.eta[..., 3] - bearing)
        ends = wrapped(torch.atan2(way[..., 1], way[..., 0]) - bearing, math.pi)
        sides = ends - torch.where(ends > 0.0, math.pi / 2.0, -math.pi / 2.0)
        price_ends, price_sides = (turn.abs() + self.turning * wrapped(off - turn).abs() for turn in (ends, sides))
        fourth = torch.maximum(state.nu[..., :2].square().sum(-1), drive / self.pace_drag).square()
        best = fourth / (fourth + self.heading_speed_mps**4) * torch.where(price_sides < price_ends, sides, ends)
        return wrapped(off - best).clamp(-self.heading_clip_rad, self.heading_clip_rad)

    def descent(self, state: Moving, goal: Tensor, distance: Tensor) -> Tensor:
        """Heave beyond trim, [B, M], N, on the glide path to goals [B, M, 3]: hurrying down gains nothing."""
        error = state.position[..., 2] - goal[..., 2]
        speed = torch.linalg.vector_norm(state.nu[..., :2], dim=-1)
        return -self.glide_damping * (state.nu[..., 2] + self.glide * error * speed / distance.clamp_min(self.near_m))

    def pushed(
        self, push: Tensor, state: Moving, goal: Tensor, way: Tensor, distance: Tensor, dt: float
    ) -> tuple[Tensor, Tensor]:
        """The push against a current, integrated from what is missing of progress, and of the goal near it.

        Args:
            push: so far, in the inertial frame, as a current is, [B, M, 2], N.
            state: [B, M].
            goal: [B, M, 3], m.
            way: unit vectors, [B, M, 2].
            distance: from the goal, [B, M], m.
            dt: s.

        Returns:
            Surge and sway [B, M, 2], N, and the push after dt.
        """
        velocity = turned_to_inertial(state.nu[..., :2], state.eta[..., 3])
        error = state.position[..., :2] - goal[..., :2]
        slow = ((velocity * way).sum(-1) < self.progress_mps)[..., None]
        on_way = self.progress_rate * slow * (self.progress_mps * way - velocity)
        still = 1.0 + velocity.square().sum(-1, keepdim=True) / self.still_mps**2
        beyond = (1.0 - self.close_m / distance.clamp_min(self.close_m))[..., None]
        at_goal = -self.goal_rate * beyond * error / (1.0 + distance[..., None]) / still
        rate = torch.where((distance > self.integral_within_m)[..., None], on_way, at_goal)
        push = (push + dt * (rate - self.forgetting * push)).clamp(-self.push_N, self.push_N)
        return torch.stack(to_body(push[..., 0], push[..., 1], state.eta[..., 3]), -1), push
