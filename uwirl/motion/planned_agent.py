"""The agent that flies plans: tau = trim + effort(t) + gain(t) (x - x(t)), planned anew as it learns more of its world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.cost import RelayCost
from uwirl.motion.flight_cost import FlightCost
from uwirl.motion.flight_guesses import guesses
from uwirl.motion.flight_plan import FlightProblem, Flights, optimise
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.route_tracker import Route, RouteTracker
from uwirl.motion.vehicle_model import VehicleModel
from uwirl.world.geometry import turned_to_body, wrapped
from uwirl.world.observation import Observation
from uwirl.world.scenario import Scenario

# Iterations on all guesses, on the best of them, and on the best one; and how many are the best.
FIRST, MIDDLE, LAST, KEPT = 8, 8, 12, 2


@dataclass(frozen=True)
class PlanSettings:
    """How flights are planned.

    Attributes:
        node_s: time between nodes, s.
        replan_s: time between plans, s.
        refine: iterations of a plan that begins with the one before.
        margin_m: clearance that the guard keeps, m.
        braking: braking distance for a squared speed of 1 (m/s)^2, as the guard counts it, s^2/m.
    """

    node_s: float = 0.2
    replan_s: float = 2.0
    refine: int = 2
    margin_m: float = 0.1
    braking: float = 0.19


class PlanCarry(NamedTuple):
    """Memory of a vehicle that flies a plan.

    Attributes:
        route: known obstacles, and the way on the map from which plans begin.
        first: step of the first node, int64 [B].
        x, effort, gain: of the plan, for B M vehicles, see `Flights`.
    """

    route: Route
    first: Tensor
    x: Tensor
    effort: Tensor
    gain: Tensor

    @property
    def blocked(self) -> Tensor:
        """Whether the newest way leads to no target, [B, M]."""
        return self.route.blocked

    @property
    def target(self) -> Tensor:
        """Where each vehicle's way leads, [B, M, 3], m."""
        return self.route.goal


@dataclass(frozen=True)
class PlannedAgent:
    """Plans flights of whole missions and flies them.

    Attributes:
        model: of one vehicle, [1]; all are alike.
        tracker: finds the ways.
        cost: running cost on the estimated channel, of M vehicles.
        frame: their link frames, [M].
        tau_max: thruster limits, [4].
        scenario: duration and time step.
        settings: of the plans.
    """

    model: VehicleModel
    tracker: RouteTracker
    cost: RelayCost
    frame: LinkFrame
    tau_max: Tensor
    scenario: Scenario
    settings: PlanSettings

    def init(self, observation: Observation) -> PlanCarry:
        """Plan the whole flight."""
        route = self.tracker.begin(observation)
        rows = torch.arange(observation.eta[..., 0].numel(), device=observation.eta.device)
        nodes = round(self.scenario.duration / self.settings.node_s) + 1
        plan = self._planned(rows, route, observation, nodes)
        return PlanCarry(route, observation.step, plan.x, plan.effort, plan.gain)

    def act(self, carry: PlanCarry, observation: Observation) -> tuple[Tensor, PlanCarry]:
        """tau [B, M, 4] and the next carry."""
        carry = self._replanned(carry, observation)
        B, M = observation.eta.shape[:2]
        node = ((observation.step - carry.first) * self.scenario.dt / self.settings.node_s).repeat_interleave(M)
        last = len(carry.effort) - 1
        k = node.long().clamp(0, last)
        share = (node - k).clamp(0.0, 1.0)[:, None]
        rows = torch.arange(B * M, device=node.device)
        planned = torch.lerp(carry.x[k, rows], carry.x[k + 1, rows], share.to(carry.x))
        off = self._state(observation) - planned
        off[:, 3] = wrapped(off[:, 3])
        # After its end a plan holds its last place.
        effort = torch.where((node > last + 1)[:, None], 0.0, carry.effort[k, rows])
        tau = self.model.trim + effort + (carry.gain[k, rows] @ off[..., None])[..., 0]
        return tau.view(B, M, 4).to(observation.eta), carry

    def _state(self, observation: Observation) -> Tensor:
        """x [B M, 8] of vehicles, with nu through the water."""
        eta, nu = observation.eta.flatten(0, 1).double(), observation.nu.flatten(0, 1).double()
        water = turned_to_body(torch.nn.functional.pad(self.model.current.expand(len(eta), 2), (0, 2)), eta[:, 3])
        return torch.cat([eta, nu - water], -1)

    def _problem(self, rows: Tensor, route: Route, observation: Observation) -> FlightProblem:
        """What vehicles, by their numbers among the B M, plan from now on."""
        M, settings = observation.eta.shape[1], self.settings
        own = rows % M
        frame = LinkFrame(self.frame.target.double()[own], self.frame.bearing.double()[own])
        clearance = self.scenario.vehicle_radius + settings.margin_m
        begin = observation.time.repeat_interleave(M)[rows]
        obstacles = route.obstacles.worlds(rows)
        cost = FlightCost(self.cost.of(rows), frame, obstacles, begin, settings.node_s, clearance, settings.braking)
        return FlightProblem(self.model.select(torch.zeros_like(rows)), cost, self.tau_max.double())

    def _planned(self, rows: Tensor, route: Route, observation: Observation, nodes: int) -> Flights:
        """Plans of some vehicles, from guesses on their ways."""
        problem, start = self._problem(rows, route, observation), self._state(observation)[rows]
        places = observation.position[..., :2].double().flatten(0, 1)
        shared = len(route.plan.goal)
        paths = route.plan.map.path(places.view(-1, shared, 2).transpose(0, 1)).transpose(0, 1).flatten(0, 1)[rows]
        x, effort = guesses(problem, start, paths, route.goal.flatten(0, 1)[rows, 2].double(), nodes)
        several = x.shape[1] // len(rows)
        index = torch.arange(len(rows), device=rows.device)
        of = index.repeat_interleave(several)
        flights = optimise(problem.select(of), start[of], x, effort, FIRST)
        for kept, iterations in ((KEPT, MIDDLE), (1, LAST)):
            several = len(of) // len(rows)
            price = torch.where(flights.J.isfinite(), flights.J + flights.defect, torch.inf)
            best = price.view(-1, several).topk(kept, 1, largest=False).indices
            of, chosen = index.repeat_interleave(kept), (index[:, None] * several + best).flatten()
            flights = optimise(problem.select(of), start[of], flights.x[:, chosen], flights.effort[:, chosen], iterations)
        return flights

    def _replanned(self, carry: PlanCarry, observation: Observation) -> PlanCarry:
        """The carry with what is known now, and plans that are due improved or, where obstacles appeared, made anew."""
        route = self.tracker.update(carry.route, observation)
        every = round(self.settings.replan_s / self.scenario.dt)
        since = observation.step - carry.first
        M, nodes = observation.eta.shape[1], len(carry.x)
        found = (route.obstacles.present != carry.route.obstacles.present).any(-1)
        carry = carry._replace(route=route)
        due = ((since % every == 0) & (since > 0)).repeat_interleave(M) & ~found
        for passed in since.unique().tolist():
            node = round(passed * self.scenario.dt / self.settings.node_s)
            if nodes - node < 5:
                continue
            here = (since == passed).repeat_interleave(M)
            for mask, fresh in ((here & found, True), (here & due, False)):
                rows = mask.nonzero()[:, 0]
                if len(rows):
                    carry = self._from(carry, rows, node, observation, fresh)
        return carry

    def _from(
        self, carry: PlanCarry, rows: Tensor, node: int, observation: Observation, fresh: bool
    ) -> PlanCarry:
        """The carry with new plans of some vehicles from a node on."""
        x, effort, gain = carry.x.clone(), carry.effort.clone(), carry.gain.clone()
        if fresh:
            plan = self._planned(rows, carry.route, observation, len(x) - node)
        else:
            problem, start = self._problem(rows, carry.route, observation), self._state(observation)[rows]
            start[:, 3] = x[node, rows, 3] + wrapped(start[:, 3] - x[node, rows, 3])
            plan = optimise(problem, start, x[node:, rows], effort[node:, rows], self.settings.refine)
        x[node:, rows], effort[node:, rows], gain[node:, rows] = plan.x, plan.effort, plan.gain
        return carry._replace(x=x, effort=effort, gain=gain)
