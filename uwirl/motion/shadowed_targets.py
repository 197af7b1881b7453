"""Where vehicles should be when shadowing is known: by search, since the SNR then has many peaks.

A place is worth the SNR of the worse of a vehicle's two links. Vehicles are placed in turn, each where that is best
with its neighbours where they are, until none gains; so with one vehicle the search is over all the places that count,
with several it ends where no single vehicle can do better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.scenario import Scenario

# From the two ends of links [Q, 3] and [Q, 3] in the order of the field to their SNR in dB, [Q].
LinkSnr = Callable[[Tensor, Tensor], Tensor]

ROUNDS = 8
# Of the best places of a grid so many are searched again on finer ones.
KEPT = 16


@dataclass(frozen=True)
class Search:
    """Grids around a vehicle's mean-channel target.

    Attributes:
        reach: half width of the first one, as a share of the hop.
        spacing: of the first one, m; vertically the same.
        finest: spacing at which a peak counts as found, m.
    """

    reach: float = 0.75
    spacing: float = 1.5
    finest: float = 0.06


def shadowed_targets(scenario: Scenario, snr: LinkSnr, targets: Tensor, search: Search | None = None) -> Tensor:
    """Targets that maximise the worst link's SNR where it is known.

    Args:
        scenario: source, destination and water.
        snr: of any link: a map when planning, the truth when judging.
        targets: of the mean channel, [M, 3], m.
        search: as named.

    Returns:
        [M, 3], m; never worse than the mean channel's.
    """
    search = search or Search()
    source, destination = scenario.source.double(), scenario.destination.double()
    places = targets.double().clone()
    hop = float(torch.linalg.vector_norm(destination - source)) / (len(places) + 1)
    for _ in range(ROUNDS):
        before = places.clone()
        for i in range(len(places)):
            # (first, second) ends: source < destination < vehicles.
            left = source if i == 0 else places[i - 1]
            right = destination if i == len(places) - 1 else places[i + 1]
            last = i == len(places) - 1

            def worse(p: Tensor, left: Tensor = left, right: Tensor = right, last: bool = last) -> Tensor:
                ahead = (right.expand_as(p), p) if last else (p, right.expand_as(p))
                return torch.minimum(snr(left.expand_as(p), p), snr(*ahead))

            places[i] = _best(worse, targets[i].double(), places[i], search, hop, scenario.depth)
        if len(places) == 1 or torch.equal(places, before):
            break
    return places.to(targets.dtype)


def _best(
    worth: Callable[[Tensor], Tensor], centre: Tensor, present: Tensor, search: Search, hop: float, depth: float
) -> Tensor:
    """Where worth [Q] of places [Q, 3] is largest around a centre [3]; the present place, if none is better."""
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
    # Ties go to the present place, so that rounds end.
    values = worth(places)
    if values[2] >= values[0]:
        return present
    return places[values.argmax()]
