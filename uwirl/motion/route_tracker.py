"""The obstacles known to each vehicle and its planned route, updated in flight."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.route import RoutePlan, Router, link_cost
from uwirl.world.observation import Observation
from uwirl.world.obstacles import Obstacles
from uwirl.world.scenario import Scenario
from uwirl.world.vehicle import Moving

# Period of obstacle detection, and period of planning when obstacles drift, s.
LOOK_PERIOD, REPLAN_PERIOD = 0.5, 1.0


class Route(NamedTuple):
    """Known obstacles and plans of B M vehicles; plans that are equal in all worlds are stored once.

    Attributes:
        obstacles: known obstacles of each vehicle, fields [B M, O(, 2)].
        plan: plans of M or B M vehicles.
        looked: step of the last obstacle detection in each world, int64 [B].
    """

    obstacles: Obstacles
    plan: RoutePlan
    looked: Tensor

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of worlds and vehicles, B and M."""
        B = len(self.looked)
        return B, len(self.obstacles.radius) // B

    @property
    def goal(self) -> Tensor:
        """Goals, [B, M, 3], m."""
        return self.plan.goal.view(-1, self.shape[1], 3).expand(*self.shape, 3)

    @property
    def rest_cost(self) -> Tensor:
        """q at the goals, [B, M]."""
        return self.plan.rest_cost.view(-1, self.shape[1]).expand(self.shape)

    @property
    def blocked(self) -> Tensor:
        """Whether the newest plan found no free route to the vehicle's target, [B, M]."""
        return self.plan.blocked.view(-1, self.shape[1]).expand(self.shape)

    def direction(self, state: Moving) -> Tensor:
        """Unit vectors along the routes, inertial, [..., B, M, 2]; zero at the goal."""
        return self._look_up(self.plan.map.descent_direction, state)

    def potential(self, state: Moving) -> Tensor:
        """Phi, the remaining cost of the routes, [..., B, M]."""
        return self._look_up(lambda places: self.plan.map.value_at(places)[..., None], state)[..., 0]

    def _look_up(self, field: Callable[[Tensor], Tensor], state: Moving) -> Tensor:
        """Evaluate a field of the maps, from [K, Q, 2] to [K, Q, C], at states [..., B, M]; returns [..., B, M, C]."""
        places = state.position[..., :2].double()
        found = field(places.reshape(-1, len(self.plan.goal), 2).transpose(0, 1)).transpose(0, 1)
        return found.reshape(*places.shape[:-1], found.shape[-1])


class RouteTracker:
    """Plans at the beginning of a flight, and again when the known obstacles change.

    Args:
        scenario: detection range, time step and obstacles.
        router: plans the routes.
    """

    def __init__(self, scenario: Scenario, router: Router):
        self.router = router
        self.discovers = scenario.detection_range < torch.inf
        obstacles = scenario.obstacles
        self.drifts = bool((obstacles.velocity.any(-1) & obstacles.present).any())
        self.look_steps, self.replan_steps = (round(T / scenario.dt) for T in (LOOK_PERIOD, REPLAN_PERIOD))

    def begin(self, observation: Observation) -> Route:
        """Routes of vehicles [B, M] that know the obstacles detected now."""
        B, M = observation.eta.shape[:2]
        known = observation.obstacles.each(lambda field: field.flatten(0, 1))
        # One plan is enough if all worlds have the same detected obstacles and start positions.
        same = self.router.targets == M and not (self.discovers or self.drifts)
        shared = same and _all_alike(observation.position) and all(_all_alike(x) for x in observation.obstacles)
        rows = torch.arange(M if shared else B * M, device=observation.eta.device)
        return Route(known, self._plan(rows, known, observation), observation.step)

    def update(self, route: Route, observation: Observation) -> Route:
        """The route updated with the obstacles detected now; the given route is not modified.

        Raises:
            ValueError: the route belongs to other worlds, or to other obstacles.
        """
        _check_carry(route, observation)
        if not (self.discovers or self.drifts):
            return route
        looks = (observation.step % self.look_steps == 0) & (observation.step != route.looked)
        if not bool(looks.any()):
            return route
        M = route.shape[1]
        seen = observation.obstacles.each(lambda field: field.flatten(0, 1))
        found = seen.present & ~route.obstacles.present & looks.repeat_interleave(M)[:, None]
        obstacles = Obstacles(
            *(
                torch.where(found if old.ndim == 2 else found[..., None], new, old)
                for old, new in zip(route.obstacles, seen, strict=True)
            )
        )
        stale = found.any(-1)
        if self.drifts:
            replans = (looks & (observation.step % self.replan_steps == 0)).repeat_interleave(M)
            stale |= replans & (obstacles.present & obstacles.velocity.any(-1)).any(-1)
        rows, plan = stale.nonzero()[:, 0], route.plan
        if len(rows):
            plan = plan.replaced(rows, self._plan(rows, obstacles, observation))
        return Route(obstacles, plan, torch.where(looks, observation.step, route.looked))

    def avoidance(self, route: Route, state: Moving, time: Tensor) -> Tensor:
        """The avoidance term of the cost at states [..., B, M] and times [..., B] in s, [..., B, M]."""
        vehicles, shape = len(route.obstacles.radius), state.position.shape[:-1]
        # Each vehicle has its own known obstacles: treat it as a world with one vehicle.
        position, time = state.position.reshape(-1, vehicles, 1, 3), time[..., None].expand(shape).reshape(-1, vehicles)
        return self.router.cost.obstacle(route.obstacles, position, time).view(shape)

    def excess(self, route: Route, state: Moving, time: Tensor) -> Tensor:
        """Cost rate minus that of the goal, link and avoidance, not below zero, [..., B, M]."""
        position = state.position
        link = link_cost(self.router.frame, self.router.cost, position.reshape(-1, self.router.targets, 3))
        q = link.view(position.shape[:-1]) + self.avoidance(route, state, time)
        return (q - route.rest_cost).clamp_min(0.0)

    def _plan(self, rows: Tensor, known: Obstacles, observation: Observation) -> RoutePlan:
        places = observation.position[..., :2].reshape(-1, 2)[rows]
        time = observation.time.repeat_interleave(observation.eta.shape[1])[rows]
        return self.router.plan(rows, places, known.worlds(rows), time)


def _check_carry(route: Route, observation: Observation) -> None:
    """Reject a carry of another flight: its shapes might broadcast and give a wrong route."""
    here = (*observation.eta.shape[:2], observation.obstacles.number)
    remembered = (*route.shape, route.obstacles.number)
    if remembered != here:
        was, now = ("{} worlds, {} vehicles and {} obstacles".format(*numbers) for numbers in (remembered, here))
        raise ValueError(f"the carry is of {was}, the observation of {now}: begin a flight with the agent's init")


def _all_alike(values: Tensor) -> bool:
    """Whether values [B, ...] are equal in all worlds."""
    return bool((values == values[:1]).all())
