"""Feature bases of critic and actor, in link-frame coordinates xi = [e_par, e_perp, e_z, psi~, u, v, w, r]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from uwirl.irl.networks import Basis, LinearActor
from uwirl.irl.solvers import Bounds
from uwirl.motion.cost import RelayCost
from uwirl.motion.linear_agent import LinkView, View
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.geometry import to_body, turned_to_inertial
from uwirl.world.relay import Relay

AXES = ("surge", "sway", "heave", "yaw")


class MotionBasis(Basis, Protocol):
    """A feature basis with a start policy (damped PD) and bounds (damped convex potentials) in its own features."""

    def start_weights(self) -> Tensor:
        """Weights of an admissible policy, [n3]."""
        ...

    def bounds(self, inertia_lower: Sequence[float], dt: float) -> Bounds:
        """Bounds within which every policy is a damped convex potential.

        Args:
            inertia_lower: a declared lower bound of the inertia of each axis, kg and kg m^2.
            dt: time for which a control is held, s; a discrete damper above inertia / (2 dt) rings.
        """
        ...

    @property
    def among_obstacles(self) -> bool:
        """Whether it uses routes among obstacles; virtual links are then drawn inside the arena."""
        ...

    def view(self, env: Relay, frame: LinkFrame) -> View:
        """The view that computes x for vehicles [B, M] on their flight to links [M] or [B, M]."""
        ...

    def state_cost(self, cost: RelayCost, x: Tensor) -> Tensor:
        """q, [..., L], at x [..., L, d]: the running cost without its control term, zero at rest at the goal."""
        ...

    def hovering(self, weights: Tensor) -> LinearActor:
        """The policy with weights [L, n3] near the target, as a function of xi."""
        ...


class LinkFrameFeatures:
    """Base class for bases with x = xi."""

    among_obstacles = False

    def view(self, env: Relay, frame: LinkFrame) -> View:
        """The view that computes xi."""
        return LinkView(frame)

    def state_cost(self, cost: RelayCost, x: Tensor) -> Tensor:
        """The terms of q that depend on xi only."""
        return cost.state(x)


class LinkFrameBasis(LinkFrameFeatures):
    """Errors along and across the link through g_L(e) = e / sqrt(1 + e^2/L^2), which saturates at L.

    Args:
        cost: running cost; its link term is one of the critic features.
        length_scales_m: values of L; infinity gives g(e) = e.
    """

    def __init__(self, cost: RelayCost, length_scales_m: Sequence[float] = (2.0, math.inf)):
        self.cost = cost
        self.scales = tuple(float(L) for L in length_scales_m)
        tags = [f"L{L:g}" for L in self.scales]
        self.critic_names = (
            *(f"{kind}_{axis}_{tag}" for tag in tags for axis in ("par", "perp", "z") for kind in ("G", "gv")),
            "link_cost",
            *(f"{v}^2" for v in "uvwr"),
            "1-cos_psi",
            "sin_psi_r",
        )
        planar = [f"g_{axis}_{tag}" for tag in tags for axis in ("par", "perp")]
        self.actor_names = (
            (*planar, "u"),
            (*planar, "v", "v|u|"),
            (*(f"g_z_{tag}" for tag in tags), "w"),
            ("sin_psi", "r", "uv"),
        )

    def saturated(self, error: Tensor, L: float) -> tuple[Tensor, Tensor]:
        """g_L(e) and its integral G_L(e), up to the factor that makes G_inf(e) = e^2."""
        if math.isinf(L):
            return error, error.square()
        root = torch.sqrt(1.0 + (error / L).square())
        return error / root, L**2 * (root - 1.0)

    def critic(self, xi: Tensor) -> Tensor:
        """phi2, [..., n2]."""
        u, v, w, r = xi[..., 4:].unbind(-1)
        c, s = torch.cos(xi[..., 3]), torch.sin(xi[..., 3])
        error, velocity = xi[..., :3], turned_to_inertial(xi[..., 4:7], xi[..., 3])
        features = []
        for L in self.scales:
            g, G = self.saturated(error, L)
            features.append(torch.stack([G, g * velocity], -1).flatten(-2))
        features.append(torch.stack([self.cost.link(xi), *(x.square() for x in (u, v, w, r)), 1.0 - c, s * r], -1))
        return torch.cat(features, -1)

    def actor(self, xi: Tensor) -> Tensor:
        """Actor features phi3, ordered by axis, [..., n3]; the link-frame errors are turned into the body frame."""
        u, v, w, r = xi[..., 4:].unbind(-1)
        c, s = torch.cos(xi[..., 3]), torch.sin(xi[..., 3])
        surge, sway, heave = [], [], []
        for L in self.scales:
            along, across, up = self.saturated(xi[..., :3], L)[0].unbind(-1)
            surge += [along * c, across * s]
            sway += [along * -s, across * c]
            heave.append(up)
        return torch.stack([*surge, u, *sway, v, v * u.abs(), *heave, w, s, r, u * v], -1)

    def _nearest(self, L: float) -> bool:
        """Whether L is the scale for the approach to the target: the smallest one, if it is finite."""
        return math.isfinite(L) and min(self.scales) == L

    def hovering(self, weights: Tensor) -> LinearActor:
        """The policy of weights [L, n3] itself, which is a function of xi."""
        return LinearActor(self, weights)

    def start_weights(self) -> Tensor:
        """Weights: -10 for the smallest finite scale, -0.3 for the others, damping -20, v|u| -60; yaw -10 and -3.5."""
        pulls = [-10.0 if self._nearest(L) else -0.3 for L in self.scales]
        planar = [pull for pull in pulls for _ in range(2)]
        surge, sway, heave, yaw = [*planar, -20.0], [*planar, -20.0, -60.0], [*pulls, -20.0], [-10.0, -3.5, 0.0]
        return torch.tensor([*surge, *sway, *heave, *yaw], dtype=torch.float64)

    def bounds(self, inertia_lower: Sequence[float], dt: float) -> Bounds:
        """Bounds of a damped convex potential that holds the heading, see MotionBasis."""
        # Per scale (own axis, other planar axis). Without a minimum pull on the own axis, vehicles that start far away
        # are very slow with some fits.
        weakest = [(-3.0, -3.0) if self._nearest(L) else (-0.3, 0.0) for L in self.scales]
        along, across = [w for pair in weakest for w in pair], [w for own, other in weakest for w in (other, own)]
        surge, sway, heave = (-inertia / (2.0 * dt) for inertia in inertia_lower[:3])
        yaw = -inertia_lower[3] / dt
        stiffest = [-400.0] * len(along)
        lower = [*stiffest, surge, *stiffest, sway, -100.0, *stiffest[::2], heave, -40.0, yaw, -20.0]
        # A heading hold: at speed, the Munk moment (m_v - m_u) u v turns a vehicle sideways unless sway is damped and
        # yaw is stiff. The yaw term of the cost is too small to learn this; without these bounds J is 12 % higher.
        upper = [*along, -2.0, *across, -2.0, -50.0, *along[::2], -2.0, -8.0, -3.0, 20.0]
        return Bounds(torch.tensor(lower, dtype=torch.float64), torch.tensor(upper, dtype=torch.float64))


class ErrorBasis(LinkFrameFeatures):
    """The paper's basis phi2 = e^2, phi3 = 2 e of the body-frame errors; with velocity, e nu, nu^2 and nu are added.

    Without velocity, the critic has B' grad V = 0, so the improved force is zero; kept to show that it fails.

    Args:
        cost: running cost; not used by these features, but all bases have this argument.
        velocity: whether to add the velocity features.
    """

    def __init__(self, cost: RelayCost | None = None, velocity: bool = True):
        self.velocity = velocity
        self.critic_names = tuple(f"e_{axis}^2" for axis in AXES)
        if velocity:
            self.critic_names += tuple(f"e_{axis}_nu" for axis in AXES) + tuple(f"nu_{axis}^2" for axis in AXES)
        self.actor_names = tuple((f"2e_{axis}", f"nu_{axis}") if velocity else (f"2e_{axis}",) for axis in AXES)

    @staticmethod
    def _body_error(xi: Tensor) -> Tensor:
        along, across, up, psi = xi[..., :4].unbind(-1)
        c, s = torch.cos(psi), torch.sin(psi)
        return torch.stack([*to_body(along, across, psi), up, torch.atan2(s, c)], -1)

    def critic(self, xi: Tensor) -> Tensor:
        """phi2, [..., 4 or 12]."""
        error, nu = self._body_error(xi), xi[..., 4:]
        if not self.velocity:
            return error.square()
        return torch.cat([error.square(), error * nu, nu.square()], -1)

    def actor(self, xi: Tensor) -> Tensor:
        """phi3, [..., 4 or 8]."""
        error = self._body_error(xi)
        if not self.velocity:
            return 2.0 * error
        return torch.stack([2.0 * error, xi[..., 4:]], -1).flatten(-2)

    def hovering(self, weights: Tensor) -> LinearActor:
        """The policy of weights [L, n3] itself, which is a function of xi."""
        return LinearActor(self, weights)

    def start_weights(self) -> Tensor:
        """A pull within the thruster limits at 40 m; damping if the basis has velocity."""
        restoring = torch.tensor([-0.3, -0.3, -1.5, -0.5], dtype=torch.float64)
        if not self.velocity:
            return restoring
        return torch.stack([restoring, torch.tensor([-20.0, -20.0, -20.0, -1.0], dtype=torch.float64)], -1).flatten()

    def bounds(self, inertia_lower: Sequence[float], dt: float) -> Bounds:
        """Bounds of a damped convex potential, see MotionBasis."""
        lower = torch.tensor([-200.0, -200.0, -200.0, -20.0], dtype=torch.float64)
        upper = torch.tensor([-0.1, -0.1, -0.1, -0.1], dtype=torch.float64)
        if self.velocity:
            damping = -torch.tensor(inertia_lower, dtype=torch.float64) / (2.0 * dt)
            lower = torch.stack([lower, damping], -1).flatten()
            upper = torch.stack([upper, torch.tensor([-2.0, -2.0, -2.0, -0.1], dtype=torch.float64)], -1).flatten()
        return Bounds(lower, upper)
