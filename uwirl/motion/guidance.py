"""How an agent is guided to its target: straight, or around obstacles on a route from the eikonal map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.motion.cost import RelayCost
from uwirl.motion.cruise import Cruise
from uwirl.motion.linear_agent import LinkController
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.mission import Mission
from uwirl.motion.route import MapSettings, Router, link_cost
from uwirl.motion.route_tracker import Route, RouteTracker
from uwirl.motion.vehicle_model import VehicleModel
from uwirl.motion.way_law import OnWay, WayLaw
from uwirl.world.agent import Agent
from uwirl.world.geometry import left_of, length, none_known, to_body
from uwirl.world.observation import Observation
from uwirl.world.scenario import Scenario


class Lead(Protocol):
    """From a controller for the last metres to an agent that flies the whole distance."""

    def __call__(self, controller: LinkController, model: VehicleModel | None = None) -> Agent:
        """The agent.

        Args:
            controller: for the last metres.
            model: of the vehicle, if one is known.
        """
        ...


# From a mission to such a function.
Guidance = Callable[[Mission], Lead]


def is_open(scenario: Scenario) -> bool:
    """Whether a single vehicle is alone in free and still water, where it needs no route."""
    return scenario.obstacles.number == 0 and scenario.vehicles == 1 and scenario.current.is_still


def go_straight(controller: LinkController, model: VehicleModel | None = None) -> Agent:
    """The controller itself, without a route."""
    return controller


class Straight:
    """guidance=straight: fly directly to the target."""

    def __call__(self, mission: Mission) -> Lead:
        """Guidance to the targets of a mission."""
        return go_straight


@dataclass(frozen=True)
class Geodesic:
    """guidance=geodesic; straight for a single vehicle in free and still water.

    Attributes:
        gain: k of the force along the route.
        lateral_damping: force against the velocity across the route, N s/m.
        heading_stiffness: moment that turns the bow or the stern into the route, N m.
        heading_damping: moment against turning, N m s/rad. Both are added to those of the controller: with the soft yaw
            control that is best at the goal, the Munk moment (m_v - m_u) u v would turn a fast vehicle sideways.
        spacing_m, exponent, hard_clearance_m: of the map, see MapSettings.
        margin_m: smallest clearance of a route, m.
        law: control law along the route.
    """

    gain: float = 0.577
    lateral_damping: float = 100.0
    heading_stiffness: float = 40.0
    heading_damping: float = 4.0
    spacing_m: float = 0.5
    exponent: float = 0.75
    hard_clearance_m: float = 0.25
    margin_m: float = 0.1
    law: WayLaw = field(default_factory=WayLaw)

    @property
    def map_settings(self) -> MapSettings:
        """Settings of the eikonal map."""
        return MapSettings(self.spacing_m, self.exponent, self.hard_clearance_m)

    def __call__(self, mission: Mission) -> Lead:
        """Guidance to the targets of a mission."""
        scenario = mission.env.scenario
        if is_open(scenario):
            return go_straight
        router = Router(scenario, mission.targets.frame, mission.cost, self.margin_m, self.map_settings)
        tracker = RouteTracker(scenario, router)
        tau_max = mission.env.vehicle.tau_max

        def lead(controller: LinkController, model: VehicleModel | None = None) -> Agent:
            cruise = None if model is None else Cruise(model, mission.cost, tau_max, scenario.dt)
            return GeodesicAgent(controller, tracker, mission.cost, self, scenario.dt, cruise)

        return lead


class RouteCarry(NamedTuple):
    """Memory of a guided vehicle.

    Attributes:
        route: known obstacles, and the planned route.
        push: force against a current, in the inertial frame, [B, M, 2], N.
    """

    route: Route
    push: Tensor

    @property
    def blocked(self) -> Tensor:
        """Whether the newest plan found no free route to the vehicle's target, [B, M]."""
        return self.route.blocked

    @property
    def target(self) -> Tensor:
        """Goal of each vehicle's route, which it announces to the others, [B, M, 3], m."""
        return self.route.goal

    @classmethod
    def begin(cls, route: Route, like: Tensor) -> RouteCarry:
        """A carry with this route and zero push, with the dtype of poses [B, M, 4]."""
        return cls(route, torch.zeros_like(like[..., :2]))


@dataclass(frozen=True)
class GeodesicAgent:
    """Follows the route in surge and sway; heave and yaw are from the controller that also takes over near the goal.

    Attributes:
        near: controller for the last metres.
        tracker: plans the route.
        cost: running cost on the estimated channel.
        settings: gains and map settings.
        dt: time step, s.
        cruise: flies along the route by a model; None to fly by the gains of `settings`.
    """

    near: LinkController
    tracker: RouteTracker
    cost: RelayCost
    settings: Geodesic
    dt: float
    cruise: Cruise | None = None

    def init(self, observation: Observation) -> RouteCarry:
        """Plan the first route."""
        return RouteCarry.begin(self.tracker.begin(observation), observation.eta)

    def act(self, carry: RouteCarry, observation: Observation) -> tuple[Tensor, RouteCarry]:
        """tau [B, M, 4]."""
        law = self.law
        route = self.tracker.update(carry.route, observation)
        seen = self._on_way(route, observation)
        share = law.near_share(seen.distance)[..., None]
        tau, progress = self.cruise.control(seen, self.near) if self.cruise else (self._tuned(seen), None)
        if not none_known(share > 0.0):
            near = self.near.towards(LinkFrame(seen.goal, self.near.frame.bearing)).control(observation)
            tau = (1.0 - share) * tau + share * near
        force, push = law.pushed(carry.push, observation, seen.goal, seen.way, seen.distance, self.dt, progress)
        return torch.cat([tau[..., :2] + force, tau[..., 2:]], -1), RouteCarry(route, push)

    @property
    def law(self) -> WayLaw:
        """What the laws with and without a model share."""
        return self.cruise.way if self.cruise else self.settings.law

    def _on_way(self, route: Route, observation: Observation) -> OnWay:
        position, psi = observation.position, observation.eta[..., 3]
        goal = route.goal.to(position.dtype)
        direction = route.direction(observation).to(position.dtype)
        way = self.law.keep_right(direction, position, observation.messages.eta[..., :3])
        link = link_cost(self.near.frame, self.cost, position)
        q = link + self.tracker.avoidance(route, observation, observation.time) - route.rest_cost
        distance = length(position[..., :2] - goal[..., :2])
        bearing = self.near.frame.bearing.to(psi).expand(psi.shape)
        return OnWay(observation, way, goal, distance, bearing, link.to(psi), q.to(psi))

    def _tuned(self, seen: OnWay) -> Tensor:
        """tau [B, M, 4] along the routes by the constants of `settings`."""
        settings, law, state, way = self.settings, self.settings.law, seen.state, seen.way
        psi, nu = state.eta[..., 3], state.nu
        u = torch.stack(to_body(way[..., 0], way[..., 1], psi), -1)
        across = left_of(u)
        drive = settings.gain * law.drive(law.pace_cost(seen.q, seen.distance), self.cost.R[:2], u)
        error = law.heading_error(way, state, seen.bearing, drive)
        drift = (nu[..., :2] * across).sum(-1)
        force = law.slowed(drive, u)[..., None] * u - settings.lateral_damping * drift[..., None] * across
        led = self.near.towards(LinkFrame(seen.goal, psi - error)).control(state)
        hold = -settings.heading_stiffness * torch.sin(error) - settings.heading_damping * nu[..., 3]
        trim = self.near.trim[..., 2].expand(psi.numel()).view(psi.shape)
        heave = trim + law.descent(state, seen.goal, seen.distance)
        return torch.cat([force, heave[..., None], led[..., 3:] + hold[..., None]], -1)
