"""Route planning around obstacles: an eikonal map of the horizontal plane for each vehicle.

    q(p) = E_L(p) - E_L,min + beta_2 E_O(p),   w = (q - q(goal) + 0.001)^0.75,   |grad Phi| = w

q is the cost rate of a position and w, the slowness, the cost per metre. At the optimal speed, w is proportional to
q^(2/3) with quadratic drag and to q^(1/2) with linear drag; 0.75 was found to be best in clutter, where a vehicle must
slow down before a turn. Closer to an obstacle than a hard clearance, w is large but finite and decreases outwards, so
that the gradient leads away from the obstacle.

The goal is the link's target. If the target is within an obstacle's influence radius, the goal is the nearby place with
the least q, which is paid as long as the vehicle stays, that still has almost the same capacity. If no free route leads
there, the goal is the reachable place with the least q, and the vehicle is `blocked`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.irl.grid_critic import GridMap, solve_eikonal
from uwirl.motion.cost import RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.chunks import at_once
from uwirl.world.geometry import length
from uwirl.world.obstacles import Obstacles
from uwirl.world.regions import separated
from uwirl.world.scenario import Scenario
from uwirl.world.vehicle import VehicleState

OFFSET = 0.001
BORDER = 8.0  # m, around everything that a map must contain
# The goal is searched within this distance of the link's target, at this spacing, with this clearance, m,
GOAL_REACH, GOAL_SPACING, GOAL_CLEARANCE = 5.0, 0.1, 0.5
# and with so small a loss of capacity that 99 % are still reached. In a chain, a neighbour may deviate to the other
# side of the link; then only a quarter of this loss is allowed for the same hop.
GOAL_LOSS = 0.008
# A drifting obstacle is put where it will be when a vehicle at this speed arrives, at most this horizon ahead.
MEETING_SPEED, MEETING_HORIZON = 1.0, 15.0  # m/s, s
# Maps solved together; more would hardly be faster.
BATCH = 32


def link_cost(frame: LinkFrame, cost: RelayCost, position: Tensor) -> Tensor:
    """E_L - E_L,min at places [..., M, 3], [..., M], never negative."""
    eta = torch.cat([position, frame.bearing[..., None].expand_as(position[..., :1])], -1)
    return cost.link(frame.relative(VehicleState.from_eta_nu(eta))).clamp_min(0.0)


class RoutePlan(NamedTuple):
    """Goals of K vehicles, and the maps that lead there.

    Attributes:
        goal: [K, 3], m.
        rest_cost: q at the goal, [K].
        blocked: whether no free route leads to the vehicle's target, [K].
        map: K maps of the horizontal plane.
    """

    goal: Tensor
    rest_cost: Tensor
    blocked: Tensor
    map: GridMap

    def replaced(self, index: Tensor, others: RoutePlan) -> RoutePlan:
        """A copy with other plans at index [K']."""
        goal, rest_cost, blocked = (
            old.index_copy(0, index, new) for old, new in zip(self[:3], others[:3], strict=True)
        )
        return RoutePlan(goal, rest_cost, blocked, self.map.replaced(index, others.map))


@dataclass(frozen=True)
class MapSettings:
    """Settings of the eikonal maps: from the cost of a place to its slowness.

    Attributes:
        spacing_m: h, m.
        exponent: exponent of q; 0 gives the shortest route.
        hard_clearance_m: closer to an obstacle than this, w is as large as inside it, m.
    """

    spacing_m: float = 0.5
    exponent: float = 0.75
    hard_clearance_m: float = 0.25


class Router:
    """Plans routes, in float64, on one grid for the whole arena.

    Args:
        scenario: nodes, starts and obstacles.
        frame: link frames of the targets, [M] or [B, M].
        cost: running cost on the estimated channel.
        margin_m: smallest clearance of a route, m.
        settings: settings of the maps.
    """

    def __init__(self, scenario: Scenario, frame: LinkFrame, cost: RelayCost, margin_m: float, settings: MapSettings):
        self.radius = scenario.vehicle_radius
        self.settings = settings
        spacing_m = settings.spacing_m
        self.margin = margin_m
        self.loss = GOAL_LOSS if scenario.vehicles == 1 else GOAL_LOSS / 4.0
        # One row per target: shared by all worlds, or one set for each world.
        self.frame = LinkFrame(frame.target.double().flatten(0, -2), frame.bearing.double().flatten())
        self.targets = len(self.frame.bearing)
        self.cost = cost.of(torch.arange(self.targets, device=frame.bearing.device))
        self.origin, self.shape = _extent(scenario, self.frame, spacing_m)
        axes = [self.origin[k] + spacing_m * torch.arange(self.shape[k], device=self.origin.device) for k in range(2)]
        self.plane = torch.cartesian_prod(*axes)
        places = _at_depth(self.plane[:, None].expand(-1, self.targets, 2), self.frame.target)
        self.link = link_cost(self.frame, self.cost, places).T

    def plan(self, vehicle: Tensor, position: Tensor, obstacles: Obstacles, time: Tensor) -> RoutePlan:
        """Plans for some vehicles, with the obstacles that each of them knows.

        Args:
            vehicle: their numbers among the B M, [K].
            position: horizontal positions, [K, 2], m.
            obstacles: known obstacles of each vehicle, fields [K, O].
            time: time in the world of each vehicle, [K], s.
        """
        now = obstacles._replace(centre=obstacles.centre + obstacles.velocity * time[:, None, None])
        row = vehicle % self.targets
        batches = torch.arange(len(vehicle), device=vehicle.device).split(at_once(BATCH, vehicle.device))
        parts = [self._plan(row[k], position[k].double(), now.worlds(k)) for k in batches]
        goal, rest_cost, blocked = (
            torch.cat([getattr(part, name) for part in parts]) for name in ("goal", "rest_cost", "blocked")
        )
        return RoutePlan(goal, rest_cost, blocked, GridMap.stack([part.map for part in parts]))

    def _plan(self, row: Tensor, position: Tensor, obstacles: Obstacles) -> RoutePlan:
        goal = self._goal(row, obstacles)
        clearance, avoidance = self._around(self.plane.expand(len(row), -1, 2), obstacles, position)
        q = self.link[row] + avoidance
        # A vehicle at the guard may be closer than the margin: gaps as narrow as its present one count as passable.
        here = self._around(position[:, None], obstacles)[0]
        inflation = self.radius + (here - 1e-6).clamp_max(self.margin)
        blocked = separated(obstacles, inflation, position, goal[:, :2])
        for k in blocked.nonzero()[:, 0].tolist():
            free = clearance[k] > GOAL_CLEARANCE
            reachable = ~separated(_one(obstacles, k), inflation[k], position[k], self.plane[free])
            free[free.clone()] = reachable
            goal[k, :2] = self.plane[torch.where(free, q[k], torch.inf).argmin()] if bool(free.any()) else position[k]
        rest_cost = self._cost_at(row, goal, obstacles)
        # A power by ln and exp, as in `uwirl.world.acoustics`, so that a batch of plans equals its singles.
        w = torch.exp(self.settings.exponent * torch.log((q - rest_cost[:, None]).clamp_min(0.0) + OFFSET))
        hard = clearance < self.settings.hard_clearance_m
        wall = 5.0 * torch.where(hard, 0.0, w).amax(-1, keepdim=True)
        w = torch.where(hard, wall * (1.0 + 4.0 * (self.settings.hard_clearance_m - clearance)), w)
        route = solve_eikonal(w.view(-1, *self.shape), self.origin, self.settings.spacing_m, goal[:, :2])
        return RoutePlan(goal, rest_cost, blocked, route)

    def _goal(self, row: Tensor, obstacles: Obstacles) -> Tensor:
        """The place of least q near each target, [K, 3]; the target itself outside all influence radii."""
        goal = self.frame.target[row]
        clearance, avoidance = self._around(goal[:, None, :2], obstacles)
        disturbed = (avoidance > 0.0) | (clearance < GOAL_CLEARANCE)
        reach = round(GOAL_REACH / GOAL_SPACING)
        axis = GOAL_SPACING * torch.arange(-reach, reach + 1, device=row.device).to(goal)
        around = torch.cartesian_prod(axis, axis)
        for k in disturbed[:, 0].nonzero()[:, 0].tolist():
            one, places = _one(obstacles, k), goal[k, :2] + around
            free = self._around(places[None], one)[0][0] > GOAL_CLEARANCE
            if bool(clearance[k] > self.margin):
                free &= ~separated(one, self.radius + self.margin, goal[k, :2], places)
            places, own = _at_depth(places, goal[k]), row[k].expand(len(places))
            worth = self._link_at(own, places) <= ((1.0 - self.loss) ** -2 - 1.0) * self.cost.minimum[row[k]]
            free = free & worth if bool((free & worth).any()) else free
            if bool(free.any()):
                goal[k] = places[torch.where(free, self._cost_at(own, places, one), torch.inf).argmin()]
        return goal

    def _cost_at(self, row: Tensor, place: Tensor, obstacles: Obstacles) -> Tensor:
        """q at a place [K, 3] for each target [K], among the obstacles of K worlds or of one."""
        return self._link_at(row, place) + self._around(place[:, None, :2], obstacles)[1][:, 0]

    def _link_at(self, row: Tensor, place: Tensor) -> Tensor:
        """E_L - E_L,min at a place [K, 3] for each target [K]."""
        return link_cost(LinkFrame(self.frame.target[row], self.frame.bearing[row]), self.cost.of(row), place)

    def _around(self, places: Tensor, obstacles: Obstacles, start: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Clearance and avoidance term at places [K, n, 2], [K, n] each.

        Args:
            places: m.
            obstacles: obstacles of K worlds.
            start: position of each vehicle, [K, 2], to predict where it meets drifting obstacles; None to use their
                present positions.
        """
        if obstacles.number == 0:
            return places.new_full(places.shape[:-1], torch.inf), places.new_zeros(places.shape[:-1])
        time: Tensor | float = 0.0
        if start is not None and bool(obstacles.velocity.any()):
            way = length(places - start[:, None])
            time = (way / MEETING_SPEED).clamp_max(MEETING_HORIZON)
        # Places are treated as worlds with one vehicle each.
        each = obstacles.each(lambda field: field[:, None])
        l = each.distance(places[:, :, None], time)[..., 0, :]
        gap = (l - each.radius).amin(-1) - self.radius
        return gap, self.cost.weights.beta_2 * self.cost.weights.avoidance(l, each.influence)


def _extent(scenario: Scenario, frame: LinkFrame, spacing: float) -> tuple[Tensor, list[int]]:
    """Origin [2] and size of the grid that contains nodes, starts, targets and obstacles."""
    obstacles = scenario.obstacles
    here = obstacles.present
    reach = (obstacles.radius[here] + BORDER).double()[:, None]
    centre = obstacles.centre[here].double()
    nodes = (scenario.source, scenario.destination, scenario.start, frame.target)
    places = torch.cat([node[..., :2].reshape(-1, 2).double() for node in nodes])
    low = torch.cat([places - BORDER, centre - reach]).amin(0)
    high = torch.cat([places + BORDER, centre + reach]).amax(0)
    return low, [n + 1 for n in ((high - low) / spacing).ceil().long().tolist()]


def _at_depth(plane: Tensor, target: Tensor) -> Tensor:
    """Places [..., 2] with the depth of targets [..., 3], as [..., 3]."""
    return torch.cat([plane, target[..., 2:].expand(*plane.shape[:-1], 1)], -1)


def _one(obstacles: Obstacles, k: int) -> Obstacles:
    """The obstacles of world k, [1, O]."""
    return obstacles.each(lambda field: field[k : k + 1])
