"""Which way round the obstacles: an eikonal map of the horizontal plane for each target.

    q(p) = E_L(p) - E_L,min + beta_2 E_O(p),   w = (q + 0.001)^0.75,   |grad Phi| = w

With quadratic drag the best pace makes the cost of a metre grow as q^(2/3), with linear drag as q^(1/2); 0.75 was found
best in clutter, where speed must be taken off before a turn. Closer to an obstacle than `HARD_CLEARANCE` w is large but
finite and falls outwards, so that the gradient leads out.
"""

from __future__ import annotations

import torch
from torch import Tensor

from uwirl.irl.grid_critic import GridMap, solve_eikonal
from uwirl.motion.cost import RelayCost
from uwirl.motion.link_frame import LinkFrame
from uwirl.world.scenario import Scenario
from uwirl.world.vehicle import VehicleState

EXPONENT = 0.75
OFFSET = 0.001
HARD_CLEARANCE = 0.25  # m
BORDER = 8.0  # m, around everything that the map must hold


def place_cost(scenario: Scenario, frame: LinkFrame, cost: RelayCost, position: Tensor) -> Tensor:
    """q of places [..., M, 3] with the heading of the link: link and avoidance terms, [..., M]."""
    eta = torch.cat([position, frame.bearing[..., None].expand_as(position[..., :1])], -1)
    xi = frame.relative(VehicleState.from_eta_nu(eta))
    return cost.link(xi).clamp_min(0.0) + cost.obstacle(scenario.obstacles.avoidance(position))


def route_map(scenario: Scenario, frame: LinkFrame, cost: RelayCost, spacing_m: float) -> GridMap:
    """Phi for the single vehicle's target, on the horizontal plane at its depth, obstacles as they stand at time 0.

    Args:
        scenario: nodes, start and obstacles, all of which the map holds.
        frame: the target's.
        cost: running cost on the estimated channel.
        spacing_m: h, m.

    Returns:
        A batch of one map, float64.
    """
    target = frame.target[0].double()
    places = torch.cat([scenario.source[None, :2], scenario.destination[None, :2], scenario.start[:, :2]]).double()
    reach = (scenario.obstacles.radius + BORDER).double()[:, None]
    centre = scenario.obstacles.centre.double()
    low = torch.cat([places - BORDER, centre - reach]).amin(0)
    high = torch.cat([places + BORDER, centre + reach]).amax(0)
    counts = ((high - low) / spacing_m).ceil().long().tolist()
    x, y = (low[axis] + spacing_m * torch.arange(counts[axis] + 1, device=low.device) for axis in range(2))
    plane = torch.cartesian_prod(x, y)
    position = torch.cat([plane, target[2].expand(len(plane), 1)], -1)[:, None]
    w = (place_cost(scenario, frame, cost, position) + OFFSET) ** EXPONENT
    clearance = scenario.clearance(position)
    hard = clearance < HARD_CLEARANCE
    w = torch.where(hard, 5.0 * w[~hard].max() * (1.0 + 4.0 * (HARD_CLEARANCE - clearance)), w)
    return solve_eikonal(w.view(1, len(x), len(y)), low, spacing_m, target[None, :2])
