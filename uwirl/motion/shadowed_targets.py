"""Target positions when shadowing is known: by search, because the SNR then has many peaks.

The value of a place is the SNR of the worse of a vehicle's two links. Vehicles are moved in turn, each to its best
place with its neighbours fixed, until none improves. For one vehicle this searches the whole region; for several, it
ends at a point that no single vehicle can improve.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class Search:
    """Grids around a vehicle's mean-channel target.

    Attributes:
        reach: half width of the first grid, as a fraction of the hop.
        spacing: spacing of the first grid, also vertically, m.
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
            places[i] = _best(worth, targets[i].double(), places[i], search, hop, scenario.depth)
        if len(places) == 1 or torch.equal(places, before):
            break
    return places.to(targets.dtype)


def _worse_link(snr: LinkSnr, left: Tensor, right: Tensor, right_first: bool) -> Callable[[Tensor], Tensor]:
    """A function from places [Q, 3] to the smaller SNR of the links with two neighbours, [Q]."""

    def worth(place: Tensor) -> Tensor:
        there = right.expand_as(place)
        return torch.minimum(snr(left.expand_as(place), place), snr(there, place) if right_first else snr(place, there))

    return worth


def _best(
    worth: Callable[[Tensor], Tensor], centre: Tensor, present: Tensor, search: Search, hop: float, depth: float
) -> Tensor:
    """The place around a centre [3] with the largest worth; the present place if none is better."""
    spacing = search.spacing
    steps = torch.arange(-round(search.reach * hop / spacing), round(search.reach * hop / spacing) + 1) * spacing
    levels = torch.arange(-depth, 1e-9, spacing) - centre[2].cpu()
    grid = torch.cartesian_prod(steps.to(centre), steps.to(centre), levels.to(centre)) + centre
    grid = torch.cat([grid, centre[None], present[None]])
    values = worth(grid)
    while spacing > search.finest:
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
