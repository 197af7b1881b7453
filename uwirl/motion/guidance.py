"""Which way a policy is led to its target: straight, or around obstacles along the eikonal map.

Minimising (q + R F^2) / v along the way gives the force F = k sqrt(q / R_b), R_b = sum_k R_k u_bk^2 with u_b the way's
direction in body axes: R_b F^2 = q / 3, k = 0.577, where drag is quadratic, R_b F^2 = q, k = 1, where it is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.cost import RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.pilot import Pilot
from uwirl.motion.policy import LinkFramePolicy, Policy
from uwirl.motion.route import MapSettings, Router, link_cost
from uwirl.motion.targets import ChainTargets
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

Lead = Callable[[LinkFramePolicy], Policy]
# Leads policies to the targets.
Guidance = Callable[[Relay, RelayCost, ChainTargets], Lead]

# Within NEAR of the goal the led policy alone, beyond FAR the route alone, in between a blend, m.
NEAR, FAR = 1.0, 3.0
# Least q that sets the pace, or the last metres would take for ever; it shrinks within 2 m of the goal.
PACE_FLOOR = 0.004
# Distance between vehicles at which they begin to give way, m.
KEEP_RIGHT = 6.0
# Speed above which the Munk moment decides the heading, m/s; largest heading error that is answered, rad.
HEADING_SPEED, HEADING_CLIP = 0.6, 0.15
# What turning by an angle counts against holding a heading that is off the link's by as much.
TURNING = 0.5
# A drive F aims at the speed sqrt(F / PACE_DRAG), roughly, N s^2/m^2.
PACE_DRAG = 20.0
# Share of the depth that is left against share of the way that is left, as its power; force for a vertical velocity
# that is off that path, N s/m.
GLIDE, GLIDE_DAMPING = 1.3, 20.0
# Against a current: progress that a force is integrated for, m/s; its rate in N/m, and how it fades, 1/s; within which
# distance of the goal, m, its error is integrated instead, N/s, as far as it exceeds what is close enough, m, and where
# the vehicle is stalled rather than on its way, m/s; the largest force, N.
PROGRESS, PROGRESS_RATE, FORGETTING = 0.35, 8.0, 0.02
INTEGRAL_WITHIN, GOAL_RATE, CLOSE, STILL = 2.0, 2.4, 0.05, 0.05
PUSH = 40.0


def go_straight(policy: LinkFramePolicy) -> Policy:
    """The policy itself."""
    return policy


def straight(env: Relay, cost: RelayCost, targets: ChainTargets) -> Lead:
    """guidance=straight."""
    return go_straight


@dataclass(frozen=True)
class Geodesic:
    """guidance=geodesic; straight for a single vehicle in free and still water.

    Attributes:
        gain: k.
        lateral_damping: force against the velocity across the way, N s/m.
        heading_stiffness: moment that turns bow or stern into the way, N m.
        heading_damping: moment against turning, N m s/rad. Both add to the led policy's: at speed the Munk moment
            (m_v - m_u) u v turns a vehicle broadside if yaw is held as softly as is best at the goal.
        margin_m: clearance below which no way leads, m.
        map_settings: of the router.
    """

    gain: float
    lateral_damping: float
    heading_stiffness: float
    heading_damping: float
    margin_m: float
    map_settings: MapSettings

    def __call__(self, env: Relay, cost: RelayCost, targets: ChainTargets) -> Lead:
        scenario = env.scenario
        if scenario.obstacles.count == 0 and scenario.vehicles == 1 and scenario.current.is_still:
            return go_straight
        router = Router(scenario, targets.frame, cost, self.margin_m, self.map_settings)
        return lambda policy: GeodesicPolicy(policy, Pilot(env, router), cost, self)


def keep_right(way: Tensor, position: Tensor) -> Tensor:
    """Ways that turn to the right of other vehicles ahead, or two that meet head-on would brake each other to a stop.

    Args:
        way: unit vectors, [B, M, 2]; zero at the goal.
        position: [B, M, 3], m.
    """
    offset = position[..., None, :, :] - position[..., :, None, :]
    close = ((KEEP_RIGHT - torch.linalg.vector_norm(offset, dim=-1)) / KEEP_RIGHT).clamp_min(0.0)
    towards = torch.nn.functional.normalize(offset[..., :2], dim=-1)
    right = torch.stack([towards[..., 1], -towards[..., 0]], -1)
    ahead = (way[..., None, :] * towards).sum(-1).clamp_min(0.0)
    turned = way + ((close * ahead)[..., None] * (right - towards)).sum(-2)
    return torch.nn.functional.normalize(turned, dim=-1)


def near_share(distance: Tensor) -> Tensor:
    """Share of the policy for the last metres at a distance from the goal, m."""
    return ((FAR - distance) / (FAR - NEAR)).clamp(0.0, 1.0)


def pace_cost(q: Tensor, distance: Tensor) -> Tensor:
    """The q that sets the pace, of a place's q less that of the goal, and the distance from there, m."""
    return torch.maximum(q, PACE_FLOOR * (distance / 2.0).square().clamp_max(1.0))


class AgainstCurrent:
    """A horizontal force integrated from what is missing of progress, and of the goal near it.

    It is kept in the inertial frame, as a current is.

    Args:
        pilot: knows when a flight begins.
    """

    push: Tensor  # [B, M, 2], N

    def __init__(self, pilot: Pilot):
        self.pilot = pilot

    def __call__(self, state: VehicleState, goal: Tensor, way: Tensor, distance: Tensor) -> Tensor:
        """Surge and sway [B, M, 2] where the way to goals [B, M, 3] is [B, M, 2] and the distance [B, M]."""
        if self.pilot.begins:
            self.push = torch.zeros_like(way)
        psi = state.eta[..., 3]
        c, s = torch.cos(psi), torch.sin(psi)
        u, v = state.nu[..., 0], state.nu[..., 1]
        velocity = torch.stack([c * u - s * v, s * u + c * v], -1)
        error = state.position[..., :2] - goal[..., :2]
        slow = ((velocity * way).sum(-1) < PROGRESS)[..., None]
        on_way = PROGRESS_RATE * slow * (PROGRESS * way - velocity)
        still = 1.0 + velocity.square().sum(-1, keepdim=True) / STILL**2
        beyond = (1.0 - CLOSE / distance.clamp_min(CLOSE))[..., None]
        at_goal = -GOAL_RATE * beyond * error / (1.0 + distance[..., None]) / still
        rate = torch.where((distance > INTEGRAL_WITHIN)[..., None], on_way, at_goal)
        rate = rate - FORGETTING * self.push
        self.push = (self.push + self.pilot.scenario.dt * rate).clamp(-PUSH, PUSH)
        x, y = self.push.unbind(-1)
        return torch.stack([c * x + s * y, c * y - s * x], -1)


def heading_error(way: Tensor, state: VehicleState, bearing: Tensor, drive: Tensor) -> Tensor:
    """How far the bow is off the best heading, [B, M], rad, clipped so that it is never turned in haste.

    The cost asks for the link's bearing; at speed V the Munk moment, which the yaw thruster pays for, asks for the bow,
    the stern or a side along the way: it is (m_v - m_u) V^2 sin(2 a) / 2 at an angle a to the way. Of the sum of both
    squares such a heading takes a share V^4 / (V^4 + V_0^4). It is bow or stern, or a side, whichever is nearer to the
    bearing, and to the present heading, lest the vehicle turn to and fro. V is the speed that the drive aims at, if
    that is more: turning is cheap as long as the vehicle is slow.

    Args:
        way: unit vectors, [B, M, 2].
        state: [B, M].
        bearing: of the links, [B, M] or [M], rad.
        drive: force along the way, [B, M], N.
    """
    off = _wrapped(state.eta[..., 3] - bearing, 2.0 * torch.pi)
    ends = _wrapped(torch.atan2(way[..., 1], way[..., 0]) - bearing, torch.pi)
    sides = ends - torch.where(ends > 0.0, torch.pi / 2.0, -torch.pi / 2.0)
    price_ends, price_sides = (
        turn.abs() + TURNING * _wrapped(off - turn, 2.0 * torch.pi).abs() for turn in (ends, sides)
    )
    fourth = torch.maximum(state.nu[..., :2].square().sum(-1), drive / PACE_DRAG).square()
    best = fourth / (fourth + HEADING_SPEED**4) * torch.where(price_sides < price_ends, sides, ends)
    return _wrapped(off - best, 2.0 * torch.pi).clamp(-HEADING_CLIP, HEADING_CLIP)


def _wrapped(angle: Tensor, period: float) -> Tensor:
    """In [-period / 2, period / 2)."""
    return torch.remainder(angle + period / 2.0, period) - period / 2.0


def slowed(drive: Tensor, u: Tensor) -> Tensor:
    """Drive [...] along ways u_b [..., 2], less where askew at an angle a: the Munk moment grows with V^2 sin(2 a)."""
    return drive / (1.0 + (2.0 * u[..., 0] * u[..., 1]).square())


def glide(state: VehicleState, goal: Tensor, distance: Tensor) -> Tensor:
    """Heave beyond trim, [B, M], N: the depth is reached a little before the goal; hurrying down gains nothing."""
    error = state.position[..., 2] - goal[..., 2]
    speed = torch.linalg.vector_norm(state.nu[..., :2], dim=-1)
    return -GLIDE_DAMPING * (state.nu[..., 2] + GLIDE * error * speed / distance.clamp_min(NEAR))


@dataclass
class GeodesicPolicy:
    """Surge and sway along the way; heave and yaw from the policy that also takes over near the goal.

    Attributes:
        near: policy for the last metres.
        pilot: knows the way.
        cost: running cost on the estimated channel.
        settings: as named.
    """

    near: LinkFramePolicy
    pilot: Pilot
    cost: RelayCost
    settings: Geodesic

    def __post_init__(self) -> None:
        self.against_current = AgainstCurrent(self.pilot)

    @property
    def blocked(self) -> Tensor:
        """Whether no way led to the vehicle's own target when last looked for, [B, M]."""
        return self.pilot.blocked

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        """tau [B, M, 4]."""
        self.pilot.update(state, step)
        goal = self.pilot.goal.to(state.components.dtype)
        way = keep_right(self.pilot.direction(state).to(goal.dtype), state.position)
        here = LinkFramePolicy(LinkFrame(goal, self.near.frame.bearing), self.near.actor, self.near.trim)
        tau = here(state, step)
        distance = torch.linalg.vector_norm(state.position[..., :2] - goal[..., :2], dim=-1)
        far = self._along(state, step, way, distance)
        share = near_share(distance)[..., None]
        tau = (1.0 - share) * far + share * tau
        push = self.against_current(state, goal, way, distance)
        return torch.cat([tau[..., :2] + push, tau[..., 2:]], -1)

    def _along(self, state: VehicleState, step: int, way: Tensor, distance: Tensor) -> Tensor:
        """tau [B, M, 4] that follows the unit vectors of the ways [B, M, 2] at the best pace."""
        psi = state.eta[..., 3]
        c, s = torch.cos(psi), torch.sin(psi)
        u = torch.stack([c * way[..., 0] + s * way[..., 1], c * way[..., 1] - s * way[..., 0]], -1)
        across = torch.stack([-u[..., 1], u[..., 0]], -1)
        q = link_cost(self.near.frame, self.cost, state.position) + self.pilot.avoidance(state, step)
        q = pace_cost(q - self.pilot.rest_cost, distance)
        # At the goal itself there is no way.
        effort = (self.cost.R[:2] * u.square()).sum(-1).clamp_min(torch.finfo(u.dtype).tiny)
        drive = self.settings.gain * torch.sqrt(q / effort)
        error = heading_error(way, state, self.near.frame.bearing, drive)
        drive = slowed(drive, u)
        drift = (state.nu[..., :2] * across).sum(-1)
        force = drive[..., None] * u - self.settings.lateral_damping * drift[..., None] * across
        led = LinkFramePolicy(LinkFrame(self.pilot.goal, psi - error), self.near.actor, self.near.trim)(state, step)
        hold = -self.settings.heading_stiffness * torch.sin(error) - self.settings.heading_damping * state.nu[..., 3]
        trim = self.near.trim[..., 2].expand(distance.numel()).view(distance.shape)
        heave = trim + glide(state, self.pilot.goal, distance)
        return torch.cat([force, heave[..., None], led[..., 3:] + hold[..., None]], -1)
