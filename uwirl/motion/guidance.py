"""Which way a policy is led to its target: straight, or around obstacles along the eikonal map.

Minimising (q + R F^2) / v along the way gives the force F = k sqrt(q / R_b), R_b = sum_k R_k u_bk^2 with u_b the way's
direction in body axes: R_b F^2 = q / 3, k = 0.577, where drag is quadratic, R_b F^2 = q, k = 1, where it is linear.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.irl.grid_critic import GridMap
from uwirl.motion.cost import RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.policy import LinkFramePolicy, Policy
from uwirl.motion.route import place_cost, route_map
from uwirl.motion.targets import ChainTargets
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

Lead = Callable[[LinkFramePolicy], Policy]
# Plans the way once, for the obstacles as they stand at the start, and leads policies along it.
Guidance = Callable[[Relay, RelayCost, ChainTargets], Lead]

# Within NEAR of the target the led policy alone, beyond FAR the route alone, in between a blend, m.
NEAR, FAR = 1.0, 3.0
# Least q that sets the pace, or the last metres would take for ever; it shrinks within 2 m of the target.
PACE_FLOOR = 0.004


@dataclass
class GeodesicPolicy:
    """Surge and sway along the route; heave and yaw from the policy that also takes over near the target.

    Far from the target that policy's yaw holds the heading along the way, bow or stern first, instead of along the
    link: moving askew costs the yaw thruster more than the cost's yaw term can be worth.

    Attributes:
        near: policy for the last metres.
        route: eikonal map to the target.
        cost: running cost on the estimated channel.
        env: supplies obstacles and nodes.
        gain: k.
        lateral_damping: force against the velocity across the way, N s/m.
    """

    near: LinkFramePolicy
    route: GridMap
    cost: RelayCost
    env: Relay
    gain: float
    lateral_damping: float

    def __call__(self, state: VehicleState, step: int) -> Tensor:
        """tau [B, 1, 4]."""
        tau = self.near(state, step)
        position, psi = state.position, state.eta[..., 3]
        places = position[:, 0, :2].double()
        way = self.route.descent_direction(places[None])[0][:, None].to(tau.dtype)
        c, s = torch.cos(psi), torch.sin(psi)
        u = torch.stack([c * way[..., 0] + s * way[..., 1], c * way[..., 1] - s * way[..., 0]], -1)
        across = torch.stack([-u[..., 1], u[..., 0]], -1)
        distance = torch.linalg.vector_norm(position[..., :2] - self.near.frame.target[..., :2], dim=-1)
        q = place_cost(self.env.scenario, self.near.frame, self.cost, position)
        q = torch.maximum(q, PACE_FLOOR * (distance / 2.0).square().clamp_max(1.0))
        effort = (self.cost.R[:2] * u.square()).sum(-1)
        drive = self.gain * torch.sqrt(q / effort)
        drift = (state.nu[..., :2] * across).sum(-1)
        force = drive[..., None] * u - self.lateral_damping * drift[..., None] * across
        # The way's bearing or its opposite, whichever the bow is nearer to.
        ahead = torch.atan2(way[..., 1], way[..., 0]) + torch.where(u[..., 0] < 0.0, torch.pi, 0.0)
        held = LinkFramePolicy(LinkFrame(self.near.frame.target, ahead), self.near.actor, self.near.trim)
        far = torch.cat([force, held(state, step)[..., 2:]], -1)
        share = ((FAR - distance) / (FAR - NEAR)).clamp(0.0, 1.0)[..., None]
        return (1.0 - share) * far + share * tau


def go_straight(policy: LinkFramePolicy) -> Policy:
    """The policy itself."""
    return policy


def straight(env: Relay, cost: RelayCost, targets: ChainTargets) -> Lead:
    """guidance=straight."""
    return go_straight


@dataclass(frozen=True)
class Geodesic:
    """guidance=geodesic; straight in free water.

    Attributes:
        gain, lateral_damping: see GeodesicPolicy.
        spacing_m: of the map, m.
    """

    gain: float
    lateral_damping: float
    spacing_m: float

    def __call__(self, env: Relay, cost: RelayCost, targets: ChainTargets) -> Lead:
        if env.scenario.obstacles.count == 0:
            return go_straight
        route = route_map(env.scenario, targets.frame, cost, self.spacing_m)
        return lambda policy: GeodesicPolicy(policy, route, cost, env, self.gain, self.lateral_damping)
