"""What each vehicle knows of the obstacles, and the way that it has planned among them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from uwirl.motion.route import Router, Ways, link_cost
from uwirl.world.obstacles import Obstacles
from uwirl.world.relay import Relay
from uwirl.world.vehicle import VehicleState

# How often obstacles are looked for, and how often the ways past drifting ones are planned anew, s.
LOOK_PERIOD, REPLAN_PERIOD = 0.5, 1.0


class Pilot:
    """Keeps the ways of B M vehicles up to date with what each has detected, from the beginning of a flight on.

    Args:
        env: supplies obstacles and the detection range.
        router: plans.
    """

    obstacles: Obstacles  # as each vehicle knows them, fields [B M, O]
    ways: Ways

    def __init__(self, env: Relay, router: Router):
        self.env = env
        self.scenario = env.scenario
        self.router = router
        self.discovers = self.scenario.detection_range < torch.inf
        everywhere = self.scenario.obstacles
        self.drifts = bool((everywhere.velocity.any(-1) & everywhere.present).any())
        self.step: int | None = None
        self.begins = True

    def update(self, state: VehicleState, step: int) -> None:
        """Plan what is new at a state [B, M]; everything, where a flight begins: when time has not moved on."""
        self.begins = self.step is None or step <= self.step
        if self.begins:
            self._begin(state, step)
        elif (self.discovers or self.drifts) and step % round(LOOK_PERIOD / self.scenario.dt) == 0:
            self._look(state, step)
        self.step = step

    def direction(self, state: VehicleState) -> Tensor:
        """Unit vectors along the ways, inertial, [..., B, M, 2]; zero at the goal."""
        return self._look_up(self.ways.map.descent_direction, state)

    def potential(self, state: VehicleState) -> Tensor:
        """Phi, what is left of the ways, [..., B, M]."""
        return self._look_up(lambda places: self.ways.map.value_at(places)[..., None], state)[..., 0]

    def avoidance(self, state: VehicleState, step: int | Tensor) -> Tensor:
        """The avoidance term of the cost at states [..., B, M] and steps, a number or [...], [..., B, M]."""
        position = state.position.reshape(-1, len(self.obstacles.radius), 1, 3)
        time = step * self.scenario.dt
        time = time.reshape(-1, 1) if isinstance(time, Tensor) else time
        return self.router.cost.obstacle(self.obstacles, position, time).view(state.position.shape[:-1])

    def excess(self, state: VehicleState, step: int | Tensor) -> Tensor:
        """By how much a place costs more than the goal: link and avoidance, not below zero, [..., B, M]."""
        position = state.position
        link = link_cost(self.router.frame, self.router.cost, position.reshape(-1, self.router.targets, 3))
        return (link.view(position.shape[:-1]) + self.avoidance(state, step) - self.rest_cost).clamp_min(0.0)

    def _look_up(self, field: Callable[[Tensor], Tensor], state: VehicleState) -> Tensor:
        """A field of the maps, from [K, Q, 2] to [K, Q, C], at the places of states [..., B, M], [..., B, M, C]."""
        places = state.position[..., :2].double()
        found = field(places.reshape(-1, len(self.ways.goal), 2).transpose(0, 1)).transpose(0, 1)
        return found.reshape(*places.shape[:-1], found.shape[-1])

    @property
    def goal(self) -> Tensor:
        """[B, M, 3], m."""
        return self.ways.goal.view(-1, self.shape[1], 3).expand(*self.shape, 3)

    @property
    def rest_cost(self) -> Tensor:
        """q at the goals, [B, M]."""
        return self.ways.rest_cost.view(-1, self.shape[1]).expand(self.shape)

    @property
    def blocked(self) -> Tensor:
        """[B, M]."""
        return self.ways.blocked.view(-1, self.shape[1]).expand(self.shape)

    def _begin(self, state: VehicleState, step: int) -> None:
        self.shape = state.position.shape[:-1]
        B, M = self.shape
        everywhere = self.scenario.obstacles
        if everywhere.radius.ndim == 1:
            self.obstacles = everywhere.each(lambda field: field.expand(B * M, *field.shape))
        else:
            self.obstacles = everywhere.each(lambda field: field.repeat_interleave(M, 0))
        self.obstacles = replace(self.obstacles, present=self._detected(state, step))
        # One plan serves all worlds that see the same and set out from the same place.
        self.shared = (
            everywhere.radius.ndim == 1
            and self.router.targets == M
            and not (self.discovers or self.drifts)
            and bool((state.position == state.position[:1]).all())
        )
        rows = torch.arange(M if self.shared else B * M, device=state.components.device)
        self.ways = self._plan(rows, state, step)

    def _look(self, state: VehicleState, step: int) -> None:
        known = self.obstacles.present | self._detected(state, step)
        stale = (known & ~self.obstacles.present).any(-1)
        if self.drifts and step % round(REPLAN_PERIOD / self.scenario.dt) == 0:
            stale |= (known & self.obstacles.velocity.any(-1)).any(-1)
        self.obstacles = replace(self.obstacles, present=known)
        rows = stale.nonzero()[:, 0]
        if len(rows):
            self.ways.put(rows, self._plan(rows, state, step))

    def _plan(self, rows: Tensor, state: VehicleState, step: int) -> Ways:
        places = state.position[..., :2].reshape(-1, 2)[rows]
        return self.router.plan(rows, places, self.obstacles.worlds(rows), step * self.scenario.dt)

    def _detected(self, state: VehicleState, step: int) -> Tensor:
        """Which obstacles are within the detection range, [B M, O]."""
        scenario = self.scenario
        gap = scenario.obstacles.clearance(state.position, scenario.vehicle_radius, step * scenario.dt)
        present = scenario.obstacles.present[..., None, :].expand(gap.shape)
        return ((gap <= scenario.detection_range) & present).flatten(0, -2)
