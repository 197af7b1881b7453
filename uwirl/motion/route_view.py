"""The features of its route that an agent with learned speed uses, and this agent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor
from uwirl.motion.cost import RelayCost
from uwirl.motion.guidance import Lead, RouteCarry
from uwirl.motion.linear_agent import LinkController, linear_control
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.mission import Mission
from uwirl.motion.route import MapSettings, Router
from uwirl.motion.route_tracker import Route, RouteTracker
from uwirl.motion.vehicle_model import VehicleModel
from uwirl.motion.way_law import WayLaw
from uwirl.world.geometry import length, to_body, to_inertial
from uwirl.world.messages import told_to_all
from uwirl.world.observation import Observation
from uwirl.world.relay import Relay
from uwirl.world.trajectory import Trajectory
from uwirl.world.vehicle import Moving, VehicleState


class WayState(NamedTuple):
    """The state x = [xi, way, phi, q] of the basis, [..., 12].

    Attributes:
        xi: in the frame of the goal that has the link's bearing, [..., 8].
        way: direction of the route, a unit vector along and across the link; zero at the goal, [..., 2].
        phi: Phi, remaining cost of the route, [..., 1].
        q: cost rate of the position minus that of the goal, link and avoidance, [..., 1].
    """

    xi: Tensor
    way: Tensor
    phi: Tensor
    q: Tensor

    @classmethod
    def of(cls, x: Tensor) -> WayState:
        """The parts of a state x [..., 12]."""
        return cls(*x.split([8, 2, 1, 1], -1))


@dataclass(frozen=True)
class RouteView:
    """Computes x for each vehicle from its route to its link, which is planned at the beginning of a flight.

    Attributes:
        tracker: plans the routes.
        bearing: bearing of the links, [M] or [B, M], rad, float64.
        law: control law along the route; here the rule to keep right.
    """

    tracker: RouteTracker
    bearing: Tensor
    law: WayLaw

    def init(self, observation: Observation) -> Route:
        """Plan the first route."""
        return self.tracker.begin(observation)

    def see(self, carry: Route, observation: Observation) -> tuple[Tensor, Route]:
        """x [B, M, 12] of an observation."""
        route = self.tracker.update(carry, observation)
        return self._see(route, observation, observation.messages.eta[..., :3], observation.time), route

    def along(self, carry: Route, trajectory: Trajectory) -> Tensor:
        """x [n + 1, B, M, 12] of a trajectory, with the obstacles known at its end."""
        states = trajectory.states
        return self._see(carry, states, told_to_all(states.position), trajectory.time[:, None])

    def _see(self, route: Route, state: Moving, others: Tensor, time: Tensor) -> Tensor:
        state = VehicleState(torch.cat([state.eta, state.nu], -1).movedim(-1, 0).double())
        xi = LinkFrame(route.goal, self.bearing).relative(state)
        x, y = self.law.keep_right(route.direction(state), state.position, others.double()).unbind(-1)
        way = torch.stack(to_body(x, y, self.bearing), -1)
        q = self.tracker.excess(route, state, time)
        return torch.cat([xi, way, torch.stack([route.potential(state), q], -1)], -1)


@dataclass(frozen=True)
class RouteAgent:
    """A linear agent that follows its route, with an integral force against currents.

    Attributes:
        view: computes x.
        actor, trim: see `linear_control`.
        dt: time step, s.
    """

    view: RouteView
    actor: LinearActor
    trim: Tensor
    dt: float

    def init(self, observation: Observation) -> RouteCarry:
        """Plan the first route."""
        return RouteCarry.begin(self.view.init(observation), observation.eta)

    def act(self, carry: RouteCarry, observation: Observation) -> tuple[Tensor, RouteCarry]:
        """tau [B, M, 4]."""
        x, route = self.view.see(carry.route, observation)
        tau, seen = linear_control(self.actor, self.trim, x), WayState.of(x)
        along, across = seen.way.unbind(-1)
        way = torch.stack(to_inertial(along, across, self.view.bearing), -1)
        distance = length(seen.xi[..., :2])
        force, push = self.view.law.pushed(carry.push, observation, route.goal, way, distance, self.dt)
        return torch.cat([tau[..., :2] + force, tau[..., 2:]], -1), RouteCarry(route, push)


@dataclass(frozen=True)
class LearnedGeodesic:
    """guidance=geodesic for agents of basis=geodesic; it also plans the routes to virtual links for learning.

    Attributes:
        margin_m: smallest clearance of a route, m.
        map_settings: settings of the eikonal maps.
        law: control law along the route.
    """

    margin_m: float
    map_settings: MapSettings
    law: WayLaw = field(default_factory=WayLaw)

    def __call__(self, mission: Mission) -> Lead:
        """Guidance to the targets of a mission."""

        def lead(controller: LinkController, model: VehicleModel | None = None) -> RouteAgent:
            view = self.view(mission.env, mission.cost, controller.frame)
            return RouteAgent(view, controller.actor, controller.trim, mission.env.scenario.dt)

        return lead

    def view(self, env: Relay, cost: RelayCost, frame: LinkFrame) -> RouteView:
        """The view for a flight to links [M] or [B, M]."""
        router = Router(env.scenario, frame, cost, self.margin_m, self.map_settings)
        return RouteView(RouteTracker(env.scenario, router), frame.bearing.double(), self.law)
