"""basis=geodesic: the speed along the route is learned from flights among obstacles, not taken from theory.

Far from the goal, surge and sway follow the route as in `uwirl.motion.way_law`; near it the link-frame policy takes
over. In between they are blended with weights f (far) and n (near), f + n = 1:

    tau = tau_trim + f (k F u_b + d (nu . n_b) n_b) + n W' phi_lf     surge and sway
    tau = tau_trim + f w glide + n W' phi_lf                          heave
    tau = tau_trim + f (w sin e + w r) + n (w sin psi~ + w r) + w uv  yaw

with u_b and n_b unit vectors along and across the route in body axes, F = sqrt(q / R_b), reduced at oblique headings,
and e the heading error. tau is linear in the weights k, d, w and W, as integral reinforcement learning requires.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.irl.solvers import Bounds
from uwirl.motion.cost import RelayCost
from uwirl.motion.features import LinkFrameBasis
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.route_view import LearnedGeodesic, RouteView, WayState
from uwirl.world.geometry import left_of, length, to_body
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

# In s(q) = q / sqrt(q + SOFT), which is sqrt(q) with a finite slope at q = 0.
SOFT = 0.003
# Start weight of u v, N m s^2/m^2.
MUNK_START = 6.0
# The gain k used to predict the speed for which the heading is chosen.
NOMINAL_GAIN = 0.577


class GeodesicBasis:
    """Features of the route, and those of a link-frame basis for the last metres.

    Args:
        cost: running cost; its link term and R are used.
        length_scales_m: length scales of the link-frame basis.
        ways: plans the routes.
    """

    among_obstacles = True

    def __init__(self, cost: RelayCost, length_scales_m: Sequence[float], ways: LearnedGeodesic):
        self.cost = cost
        self.ways = ways
        self.near = LinkFrameBasis(cost, length_scales_m)
        self.near_sizes = [len(names) for names in self.near.actor_names]
        self.critic_names = (
            *self.near.critic_names,
            *("Phi", "Phi^2", "s(q)_nu_along", "q_nu_along", "nu_along^2", "nu_across^2"),
        )
        surge, sway, heave, yaw = self.near.actor_names
        along = ("F_along", "nu_across")
        hold = ("sin_error", "r_way")
        self.actor_names = ((*along, *surge), (*along, *sway), ("glide", *heave), (*hold, *yaw))

    def _axes(self, x: WayState) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """u_b and n_b, [..., 2], and the velocities along and across the route, [...]."""
        u = torch.stack(to_body(x.way[..., 0], x.way[..., 1], x.xi[..., 3]), -1)
        n = left_of(u)
        nu = x.xi[..., 4:6]
        return u, n, (nu * u).sum(-1), (nu * n).sum(-1)

    def critic(self, x: Tensor) -> Tensor:
        """Critic features phi2, [..., n2]."""
        seen = WayState.of(x)
        phi, q = seen.phi[..., 0], seen.q[..., 0]
        _, _, along, across = self._axes(seen)
        pull = q / torch.sqrt(q + SOFT)
        way = [phi, phi.square() / 10.0, pull * along, q * along, along.square(), across.square()]
        return torch.cat([self.near.critic(seen.xi), torch.stack(way, -1)], -1)

    def actor(self, x: Tensor) -> Tensor:
        """Actor features phi3, ordered by axis, [..., n3]."""
        seen = WayState.of(x)
        u, n, _, across = self._axes(seen)
        distance = length(seen.xi[..., :2])
        law = self.ways.law
        near = law.near_share(distance)[..., None]
        far = 1.0 - near
        force = law.drive(law.pace_cost(seen.q[..., 0], distance), self.cost.R[:2], u)
        along, damped = law.slowed(force, u)[..., None] * u, across[..., None] * n
        # In the goal's frame, in which the bearing is zero.
        state, zero = VehicleState(seen.xi.movedim(-1, 0)), torch.zeros_like(distance)
        error = law.heading_error(seen.way, state, zero, NOMINAL_GAIN * force)
        surge, sway, heave, yaw = self.near.actor(seen.xi).split(self.near_sizes, -1)
        features = [far * torch.stack([along[..., 0], damped[..., 0]], -1), near * surge]
        features += [far * torch.stack([along[..., 1], damped[..., 1]], -1), near * sway]
        features += [far * law.descent(state, torch.zeros_like(seen.xi[..., :3]), distance)[..., None], near * heave]
        features += [far * torch.stack([torch.sin(error), seen.xi[..., 7]], -1), near * yaw[..., :2], yaw[..., 2:]]
        return torch.cat(features, -1)

    def view(self, env: Relay, frame: LinkFrame) -> RouteView:
        """The view for a flight to links [M] or [B, M]."""
        return self.ways.view(env, self.cost, frame)

    def state_cost(self, cost: RelayCost, x: Tensor) -> Tensor:
        """q minus that of the goal, plus the yaw term, [..., L]."""
        seen = WayState.of(x)
        return seen.q[..., 0] + cost.yaw(seen.xi)

    def hovering(self, weights: Tensor) -> LinearActor:
        """The link-frame policy."""
        parts = weights.split([len(names) for names in self.actor_names], -1)
        near = [part[..., far:] for part, far in zip(parts, (2, 2, 1, 2), strict=True)]
        return LinearActor(self.near, torch.cat(near, -1))

    def weights(self, near: Tensor, way: Sequence[float], glide: float, heading: Sequence[float]) -> Tensor:
        """Weights [n3] from those of the link-frame basis, (k, d), glide damping, and heading stiffness and damping."""
        far = [near.new_tensor(x) for x in (way, way, [glide], heading)]
        parts = zip(far, near.split(self.near_sizes, -1), strict=True)
        return torch.cat([part for pair in parts for part in pair])

    def start_weights(self) -> Tensor:
        """k = 1, optimal for linear drag; the other weights are the start weights of the link-frame basis."""
        near = self.near.start_weights()
        near[-1] = MUNK_START
        return self.weights(near, (1.0, -100.0), 1.0, (-40.0, -6.0))

    def bounds(self, inertia_lower: Sequence[float], dt: float) -> Bounds:
        """Bounds of the link-frame basis, and of the pace, the depth and the heading along the way."""
        near = self.near.bounds(inertia_lower, dt)
        # The Munk moment always turns a vehicle sideways to its route; a negative weight would add to it.
        near.lower[-1] = 0.0
        # A heading hold that is strong enough for the Munk moment at speed. The data favour softer ones, but they come
        # from flights which that moment deflected (k = 0.8, J 20 % higher in clutter).
        # k is 0.577 for quadratic and 1 for linear drag; vehicles seldom fly sideways, so that k is badly determined.
        lower = self.weights(near.lower, (0.4, -200.0), 0.2, (-80.0, -2.0 * inertia_lower[3] / dt))
        upper = self.weights(near.upper, (1.2, -30.0), 3.0, (-40.0, -5.0))
        return Bounds(lower, upper)
