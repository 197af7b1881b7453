"""The agent that flies plans: tau = trim + effort(t) + gain(t) (x - x(t)), planned anew as its world changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.flight_cost import FlightCost
from uwirl.motion.flight_plan import FlightProblem, Flights, optimise
from uwirl.motion.guidance import GeodesicAgent, RouteCarry
from uwirl.motion.link_frame import LinkFrame
from uwirl.motion.route_tracker import Route
from uwirl.motion.vehicle_model import VehicleModel
from uwirl.world.geometry import length, turned_to_body, turned_to_inertial, wrapped
from uwirl.world.observation import Observation
from uwirl.world.obstacles import Obstacles
from uwirl.world.scenario import Scenario

# Iterations of a new plan.
ITERATIONS = 24
# A plan whose dynamics are violated by more, or that comes closer to an obstacle than this, is not flown; SI units, m.
MOST_DEFECT, LEAST_GAP = 0.1, -0.05
# A vehicle farther from its plan than this begins a new one; one closer than that keeps it, unless obstacles or other
# vehicles move, m.
LOST, CLOSE = 0.5, 0.05
# Fewer nodes are not worth a new plan.
LEAST_NODES = 10
# Longest step of the flight by the law from which a plan begins, s.
REHEARSED_S = 0.1
# Vehicles planned together: enough to hide the cost of a call, few enough for the memory.
BATCH = 32


@dataclass(frozen=True)
class PlanSettings:
    """How flights are planned.

    Attributes:
        node_s: time between nodes, s; a fast vehicle's Munk moment must not turn it far within.
        replan_s: time between plans, s.
        refine: iterations of a plan that begins with the one before.
        margin_m: clearance that the guard keeps, m.
        braking: braking distance for a squared speed of 1 (m/s)^2, as the guard counts it, s^2/m.
        separation_m: distance that the guard keeps between vehicles, m.
    """

    node_s: float = 0.1
    replan_s: float = 2.0
    refine: int = 2
    margin_m: float = 0.1
    braking: float = 0.19
    separation_m: float = 1.0


class PlanCarry(NamedTuple):
    """Memory of a vehicle that flies a plan.

    Attributes:
        route: known obstacles, and the way on the map from which plans begin.
        push: of the reactive agent, see `RouteCarry`.
        first: step of the first node, int64 [B].
        flown: whether the plan is good enough to be flown, bool [B M]; the reactive agent flies otherwise.
        x, effort, gain: of the plan, for B M vehicles, see `Flights`.
    """

    route: Route
    push: Tensor
    first: Tensor
    flown: Tensor
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
        reactive: finds the ways, and flies where there is no good plan.
        tau_max: thruster limits, [4].
        scenario: duration and time step.
        settings: of the plans.
    """

    model: VehicleModel
    reactive: GeodesicAgent
    tau_max: Tensor
    scenario: Scenario
    settings: PlanSettings

    def init(self, observation: Observation) -> PlanCarry:
        """Plan the whole flight."""
        begun = self.reactive.init(observation)
        rows = torch.arange(observation.eta[..., 0].numel(), device=observation.eta.device)
        left = self.scenario.duration - float(observation.time.max())
        nodes = max(round(left / self.settings.node_s) + 1, LEAST_NODES)
        plan, good = self._planned(rows, begun.route, observation, nodes)
        return PlanCarry(begun.route, begun.push, observation.step, good, plan.x, plan.effort, plan.gain)

    def act(self, carry: PlanCarry, observation: Observation) -> tuple[Tensor, PlanCarry]:
        """tau [B, M, 4] and the next carry."""
        carry = self._replanned(carry, observation)
        tau = self._followed(carry, observation)
        if bool(carry.flown.all()):
            return tau, carry
        reactive, after = self.reactive.act(RouteCarry(carry.route, carry.push), observation)
        mask = carry.flown.view(tau.shape[:2])[..., None]
        return torch.where(mask, tau, reactive), carry._replace(push=after.push)

    def _followed(self, carry: PlanCarry, observation: Observation) -> Tensor:
        """tau [B, M, 4] of the plans."""
        # After its end a plan holds its last place.
        k, rows, off = self._off(carry, observation)
        tau = self.model.trim + carry.effort[k, rows] + (carry.gain[k, rows] @ off[..., None])[..., 0]
        return tau.view(observation.eta.shape).to(observation.eta)

    def _off(self, carry: PlanCarry, observation: Observation) -> tuple[Tensor, Tensor, Tensor]:
        """Node and number of each vehicle, and its deviation from the plan, [B M, 8]."""
        M = observation.eta.shape[1]
        node = ((observation.step - carry.first) * self.scenario.dt / self.settings.node_s).repeat_interleave(M)
        last = len(carry.effort) - 1
        k = node.long().clamp(0, last)
        share = (node - k).clamp(0.0, 1.0)[:, None]
        rows = torch.arange(len(k), device=k.device)
        off = self._state(observation) - torch.lerp(carry.x[k, rows], carry.x[k + 1, rows], share.to(carry.x))
        off[:, 3] = wrapped(off[:, 3])
        return k, rows, off

    def _state(self, observation: Observation) -> Tensor:
        """x [B M, 8] of vehicles, with nu through the water."""
        eta, nu = observation.eta.flatten(0, 1).double(), observation.nu.flatten(0, 1).double()
        return torch.cat([eta, nu - self._water(eta[:, 3])], -1)

    def _water(self, psi: Tensor) -> Tensor:
        """Velocity of the water in body axes, [B M, 4], at headings [B M]."""
        return turned_to_body(torch.nn.functional.pad(self.model.current.expand(len(psi), 2), (0, 2)), psi)

    def _replanned(self, carry: PlanCarry, observation: Observation) -> PlanCarry:
        """The carry with what is known now.

        Plans that are due are improved; those of vehicles that found obstacles or left their plan are made anew.
        """
        route = self.reactive.tracker.update(carry.route, observation)
        M, nodes = observation.eta.shape[1], len(carry.x)
        since = observation.step - carry.first
        due = (since % round(self.settings.replan_s / self.scenario.dt) == 0) & (since > 0)
        found = (route.obstacles.present != carry.route.obstacles.present).any(-1)
        carry = carry._replace(route=route)
        if not bool(due.any() | found.any()):
            return carry
        due = due.repeat_interleave(M)
        away = length(self._off(carry, observation)[2][:, :3])
        # Where the way is blocked there will be a plan only once the obstacles are known to be others.
        anew = found | (due & ((away > LOST) | ~carry.flown) & ~route.blocked.flatten())
        moving = M > 1 or self.reactive.tracker.drifts
        improved = due & ~anew & ((away > CLOSE) | moving)
        for passed in since.unique().tolist():
            node = round(passed * self.scenario.dt / self.settings.node_s)
            here = (since == passed).repeat_interleave(M)
            if nodes - node >= LEAST_NODES:
                carry = self._renewed(carry, (here & anew).nonzero()[:, 0], node, observation, True)
                carry = self._renewed(carry, (here & improved).nonzero()[:, 0], node, observation, False)
        return carry

    def _renewed(self, carry: PlanCarry, rows: Tensor, node: int, observation: Observation, anew: bool) -> PlanCarry:
        """The carry with plans of some vehicles from a node on that are made anew, or improved."""
        if not len(rows):
            return carry
        x, effort, gain, flown = (part.clone() for part in (carry.x, carry.effort, carry.gain, carry.flown))
        if anew:
            plan, good = self._planned(rows, carry.route, observation, len(x) - node)
        else:
            problem, start = self._problem(rows, carry.route, observation), self._state(observation)[rows]
            start[:, 3] = x[node, rows, 3] + wrapped(start[:, 3] - x[node, rows, 3])
            plan = optimise(problem, start, x[node:, rows], effort[node:, rows], self.settings.refine)
            good = flown[rows]
        x[node:, rows], effort[node:, rows], gain[node:, rows], flown[rows] = plan.x, plan.effort, plan.gain, good
        return carry._replace(x=x, effort=effort, gain=gain, flown=flown)

    def _planned(self, rows: Tensor, route: Route, observation: Observation, nodes: int) -> tuple[Flights, Tensor]:
        """Plans of some vehicles, which begin as flown by the law, and whether each is good enough to be flown."""
        x, effort = self._rehearsed(route, observation, nodes)
        plans, found = [], []
        for some in rows.split(BATCH):
            problem, start = self._problem(some, route, observation), self._state(observation)[some]
            plan = optimise(problem, start, x[:, some], effort[:, some], ITERATIONS)
            near = (problem.cost.gap(plan.x) > LEAST_GAP) | (problem.cost.gap(plan.x[:1]) <= LEAST_GAP)
            plans.append(plan)
            found.append(plan.J.isfinite() & (plan.defect < MOST_DEFECT) & near & ~route.blocked.flatten()[some])
        return Flights.joined(plans), torch.cat(found)

    def _rehearsed(self, route: Route, observation: Observation, nodes: int) -> tuple[Tensor, Tensor]:
        """What the reactive agent would fly by the model: x [nodes, B M, 8] and effort [nodes - 1, B M, 4].

        Obstacles and other vehicles stay where they are.
        """
        parts = math.ceil(self.settings.node_s / REHEARSED_S - 1e-9)
        dt, cruise = self.settings.node_s / parts, self.reactive.cruise
        reactive = replace(self.reactive, dt=dt, cruise=cruise and replace(cruise, dt=dt))
        carry = RouteCarry.begin(route, observation.eta)
        x, limits = self._state(observation), self.tau_max.double()
        xs, efforts = [x], []
        for _ in range(parts * (nodes - 1)):
            nu = x[:, 4:] + self._water(x[:, 3])
            eta, nu = (part.to(observation.eta).view(observation.eta.shape) for part in (x[:, :4], nu))
            tau, carry = reactive.act(carry, observation._replace(eta=eta, nu=nu))
            effort = tau.flatten(0, 1).double().clamp(-limits, limits) - self.model.trim
            after = self.model.after(x, effort, dt)
            # A model so poor that its flight ends nowhere makes no plan.
            x = torch.where(after.isfinite().all(-1, keepdim=True), after, x)
            xs.append(x)
            efforts.append(effort)
        return torch.stack(xs[::parts]), torch.stack(efforts).unflatten(0, (nodes - 1, parts)).mean(1)

    def _problem(self, rows: Tensor, route: Route, observation: Observation) -> FlightProblem:
        """What vehicles, by their numbers among the B M, plan from now on."""
        M, settings = observation.eta.shape[1], self.settings
        frame = self.reactive.near.frame
        frame = LinkFrame(frame.target.double()[rows % M], frame.bearing.double()[rows % M])
        begin = observation.time.repeat_interleave(M)[rows]
        clearance = self.scenario.vehicle_radius + settings.margin_m
        obstacles = route.obstacles.worlds(rows)
        if M > 1:
            others = _as_obstacles(observation, settings.separation_m - clearance).each(lambda field: field[rows])
            obstacles = Obstacles(*(torch.cat(pair, 1) for pair in zip(obstacles, others, strict=True)))
        cost = self.reactive.cost.of(rows)
        flights = FlightCost(cost, frame, obstacles, begin, settings.node_s, clearance, settings.braking)
        return FlightProblem(self.model.select(torch.zeros_like(rows)), flights, self.tau_max.double())


def _as_obstacles(observation: Observation, radius: float) -> Obstacles:
    """The other vehicles as each of them was heard, flying on as they do; fields [B M, M(, 2)]."""
    heard = observation.messages
    velocity = turned_to_inertial(heard.nu[..., :2], heard.eta[..., 3]).double()
    centre = heard.eta[..., :2].double() - velocity * observation.time[:, None, None, None]
    size = torch.full_like(centre[..., 0], radius)
    M = size.shape[-1]
    present = ~torch.eye(M, dtype=torch.bool, device=size.device).expand(size.shape)
    # No farther influence: the running cost counts no vehicles.
    parts = Obstacles(centre=centre, radius=size, influence=size, velocity=velocity, present=present)
    return parts.each(lambda field: field.flatten(0, 1))
