"""What each vehicle knows of the obstacles, and the route that it has planned among them, kept up to date in flight."""

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

# How often obstacles are looked for, and how often the ways past drifting ones are planned anew, s.
LOOK_PERIOD, REPLAN_PERIOD = 0.5, 1.0


class Route(NamedTuple):
    """What B M vehicles remember of obstacles, and their plans; plans that are the same in all worlds are kept once.

    Attributes:
        obstacles: as each vehicle knows them, fields [B M, O(, 2)].
        plan: of M vehicles, or of B M.
        looked: the step at which each world's vehicles last looked for obstacles, int64 [B].
    """

    obstacles: Obstacles
    plan: RoutePlan
    looked: Tensor

    @property
    def shape(self) -> tuple[int, int]:
        """B, M."""
        B = len(self.looked)
        return B, len(self.obstacles.radius) // B

    @property
    def goal(self) -> Tensor:
        """[B, M, 3], m."""
        return self.plan.goal.view(-1, self.shape[1], 3).expand(*self.shape, 3)

    @property
    def rest_cost(self) -> Tensor:
        """q at the goals, [B, M]."""
        return self.plan.rest_cost.view(-1, self.shape[1]).expand(self.shape)

    @property
    def blocked(self) -> Tensor:
        """Whether no way led to the vehicle's own target when last looked for, [B, M]."""
        return self.plan.blocked.view(-1, self.shape[1]).expand(self.shape)

    def direction(self, state: Moving) -> Tensor:
        """Unit vectors along the ways, inertial, [..., B, M, 2]; zero at the goal."""
        return self._look_up(self.plan.map.descent_direction, state)

    def potential(self, state: Moving) -> Tensor:
        """Phi, what is left of the ways, [..., B, M]."""
        return self._look_up(lambda places: self.plan.map.value_at(places)[..., None], state)[..., 0]

    def _look_up(self, field: Callable[[Tensor], Tensor], state: Moving) -> Tensor:
        """A field of the maps, from [K, Q, 2] to [K, Q, C], at the places of states [..., B, M], [..., B, M, C]."""
        places = state.position[..., :2].double()
        found = field(places.reshape(-1, len(self.plan.goal), 2).transpose(0, 1)).transpose(0, 1)
        return found.reshape(*places.shape[:-1], found.shape[-1])


class RouteTracker:
    """Plans where a flight begins, and anew what has changed since.

    Args:
        scenario: detection range and time step, and whether anything in these waters drifts.
        router: plans.
    """

    def __init__(self, scenario: Scenario, router: Router):
        self.router = router
        self.discovers = scenario.detection_range < torch.inf
        obstacles = scenario.obstacles
        self.drifts = bool((obstacles.velocity.any(-1) & obstacles.present).any())
        self.look_steps, self.replan_steps = (round(T / scenario.dt) for T in (LOOK_PERIOD, REPLAN_PERIOD))

    def begin(self, observation: Observation) -> Route:
        """Routes of vehicles [B, M] that know what they see now."""
        B, M = observation.eta.shape[:2]
        known = observation.obstacles.each(lambda field: field.flatten(0, 1))
        # One plan serves all worlds that see the same and set out from the same place.
        same = self.router.targets == M and not (self.discovers or self.drifts)
        shared = same and _all_alike(observation.position) and all(_all_alike(x) for x in observation.obstacles)
        rows = torch.arange(M if shared else B * M, device=observation.eta.device)
        return Route(known, self._plan(rows, known, observation), observation.step)

    def update(self, route: Route, observation: Observation) -> Route:
        """With what is detected now; the given route stays as it is.

        Raises:
            ValueError: the route is of other worlds, or among other obstacles.
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
        # Each vehicle has obstacles of its own, as a world of one vehicle has.
        position, time = state.position.reshape(-1, vehicles, 1, 3), time[..., None].expand(shape).reshape(-1, vehicles)
        return self.router.cost.obstacle(route.obstacles, position, time).view(shape)

    def excess(self, route: Route, state: Moving, time: Tensor) -> Tensor:
        """By how much a place costs more than the goal: link and avoidance, not below zero, [..., B, M]."""
        position = state.position
        link = link_cost(self.router.frame, self.router.cost, position.reshape(-1, self.router.targets, 3))
        q = link.view(position.shape[:-1]) + self.avoidance(route, state, time)
        return (q - route.rest_cost).clamp_min(0.0)

    def _plan(self, rows: Tensor, known: Obstacles, observation: Observation) -> RoutePlan:
        places = observation.position[..., :2].reshape(-1, 2)[rows]
        time = observation.time.repeat_interleave(observation.eta.shape[1])[rows]
        return self.router.plan(rows, places, known.worlds(rows), time)


def _check_carry(route: Route, observation: Observation) -> None:
    """Refuse what was remembered of another flight: numbers of vehicles might broadcast, and fly to nowhere."""
    here = (*observation.eta.shape[:2], observation.obstacles.number)
    remembered = (*route.shape, route.obstacles.number)
    if remembered != here:
        was, now = ("{} worlds, {} vehicles and {} obstacles".format(*numbers) for numbers in (remembered, here))
        raise ValueError(f"the carry is of {was}, the observation of {now}: begin a flight with the agent's init")


def _all_alike(values: Tensor) -> bool:
    """Whether [B, ...] is the same in all worlds."""
    return bool((values == values[:1]).all())
