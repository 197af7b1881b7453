"""Target positions when shadowing is known: by search, because the SNR then has many peaks.

The value of a place is the SNR of the worse of a vehicle's two links. Vehicles are moved in turn, each to its best
place with its neighbours fixed, until none improves. For one vehicle this searches the whole region; for several, it
ends at a point that no single vehicle can improve.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.scenario import Scenario

# From the two ends of links, [Q, 3] each in the order of the field, to their SNR in dB, [Q].
LinkSnr = Callable[[Tensor, Tensor], Tensor]

ROUNDS = 8
# This many best places of a grid are searched again on finer grids.
KEPT = 16
# Places of the first grids of all vehicles together, and levels of each: over longer hops and in deeper water the
# grids are coarser, so that neither time nor memory grows with the world.
MOST_PLACES, MOST_LEVELS = 2**17, 64


@dataclass(frozen=True)
class Search:
    """Grids around a vehicle's mean-channel target.

    Attributes:
        reach: half width of the first grid, as a fraction of the hop.
        spacing: least spacing of the first grid, also vertically, m.
        finest: spacing at which the search ends, m.
    """

    reach: float = 0.75
    spacing: float = 1.5
    finest: float = 0.06


def shadowed_targets(scenario: Scenario, snr: LinkSnr, targets: Tensor, search: Search | None = None) -> Tensor:
    """Targets that maximise the worst link's SNR for a known or mapped field.

    Args:
        scenario: source, destination and water.
        snr: SNR of any link: a map for planning, the truth for evaluation.
        targets: targets of the mean channel, [M, 3], m.
        search: grids.

    Returns:
        [M, 3], m; never worse than those of the mean channel.
    """
    search = search or Search()
    source, destination = scenario.source.double(), scenario.destination.double()
    places = targets.double().clone()
    hop = float(torch.linalg.vector_norm(destination - source)) / (len(places) + 1)
    for _ in range(ROUNDS):
        before = places.clone()
        for i in range(len(places)):
            left, right = torch.cat([source[None], places, destination[None]])[[i, i + 2]]
            worth = _worse_link(snr, left, right, right_first=i == len(places) - 1)
            grid, spacing = _first_grid(search, targets[i].double(), hop, scenario.depth, MOST_PLACES / len(places))
            places[i] = _best(worth, grid, spacing, targets[i].double(), places[i], search.finest, scenario.depth)
        if len(places) == 1 or torch.equal(places, before):
            break
    return places.to(targets.dtype)


def _worse_link(snr: LinkSnr, left: Tensor, right: Tensor, right_first: bool) -> Callable[[Tensor], Tensor]:
    """A function from places [Q, 3] to the smaller SNR of the links with two neighbours, [Q]."""

    def worth(place: Tensor) -> Tensor:
        there = right.expand_as(place)
        return torch.minimum(snr(left.expand_as(place), place), snr(there, place) if right_first else snr(place, there))

    return worth


def _first_grid(search: Search, centre: Tensor, hop: float, depth: float, most: float) -> tuple[Tensor, float]:
    """Places [Q, 3] around a centre [3], about `most` of them or fewer, and their largest spacing, m."""
    upwards = max(search.spacing, depth / MOST_LEVELS)
    side = math.sqrt(most / (depth / upwards + 1.0))
    across = max(search.spacing, 2.0 * search.reach * hop / side)
    reach = round(search.reach * hop / across)
    steps = torch.arange(-reach, reach + 1) * across
    levels = torch.arange(-depth, 1e-9, upwards) - centre[2].cpu()
    return torch.cartesian_prod(steps.to(centre), steps.to(centre), levels.to(centre)) + centre, max(across, upwards)


def _best(
    worth: Callable[[Tensor], Tensor],
    grid: Tensor,
    spacing: float,
    centre: Tensor,
    present: Tensor,
    finest: float,
    depth: float,
) -> Tensor:
    """The place with the largest worth on a first grid [Q, 3] and finer ones; the present place if none is better."""
    grid = torch.cat([grid, centre[None], present[None]])
    values = worth(grid)
    while spacing > finest:
        best = grid[values.topk(min(KEPT, len(grid))).indices]
        spacing /= 3.0
        offsets = spacing * torch.arange(-2, 3).to(centre)
        around = torch.cartesian_prod(offsets, offsets, offsets)
        grid = (best[:, None] + around).flatten(0, 1)
        grid[:, 2] = grid[:, 2].clamp(-depth, 0.0)
        grid = torch.cat([grid, best])
        values = worth(grid)
    places = torch.stack([grid[values.argmax()], centre, present])
    # With equal values the present place is kept, so that the rounds end.
    values = worth(places)
    if values[2] >= values[0]:
        return present
    return places[values.argmax()]
