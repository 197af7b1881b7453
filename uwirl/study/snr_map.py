"""A horizontal map of the SNR, its uncertainty and outage that readings let expect of links from one place."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.kriging import Kriging

NODES = 3500
# Around the places, as a share of the longest distance between them along an axis.
MARGIN = 0.1
# Of nodes and readings, a factor of the time: some minutes.
MAX_ENTRIES = 2**30
# Nearer than this to the sender (K is the SNR at 1 m, of point-like nodes) path loss says nothing.
NEAREST_M = 1.0


class Grid(NamedTuple):
    """Where the map is.

    Attributes:
        x: [X], m.
        y: [Y], m.
        z: m.
        spacing: m.
    """

    x: Tensor
    y: Tensor
    z: float
    spacing: float

    @property
    def places(self) -> Tensor:
        """[Y X, 3], m, along x first."""
        y, x = torch.meshgrid(self.y, self.x, indexing="ij")
        return torch.stack([x, y, torch.full_like(x, self.z)], -1).flatten(0, 1)


class SnrMap(NamedTuple):
    """Of links from one place to a grid; nan beside that place.

    Attributes:
        grid: as named.
        sender: [3], m.
        mean: expected SNR, path loss and shadowing, [Y, X], dB.
        std: its standard deviation, [Y, X], dB.
        capacity: at that SNR, [Y, X], kbit/s.
        threshold: what counts as outage below it, kbit/s.
        outage: probability that the link carries less, [Y, X].
    """

    grid: Grid
    sender: Tensor
    mean: Tensor
    std: Tensor
    capacity: Tensor
    threshold: float
    outage: Tensor


def make_grid(places: Tensor, z: float, spacing: float | None, readings: int) -> Grid:
    """Around places.

    Args:
        places: [k, 3], m.
        z: of the map, m.
        spacing: m; None for about NODES nodes.
        readings: how many the map is kriged from.

    Raises:
        ValueError: fewer nodes than a map has, or more than there is time for.
    """
    low, high = places.amin(0), places.amax(0)
    margin = MARGIN * float((high - low).max())
    (x0, y0), (x1, y1) = ((edge + sign * margin)[:2].tolist() for edge, sign in ((low, -1.0), (high, 1.0)))
    spacing = spacing or math.sqrt((x1 - x0) * (y1 - y0) / NODES)
    if spacing > 0.5 * min(x1 - x0, y1 - y0):
        raise ValueError(f"{spacing:g} m leaves fewer than 3 nodes across the map; choose less")
    nodes = (math.floor((x1 - x0) / spacing) + 1) * (math.floor((y1 - y0) / spacing) + 1)
    if nodes * readings > MAX_ENTRIES:
        least = math.sqrt((x1 - x0) * (y1 - y0) * readings / MAX_ENTRIES)
        raise ValueError(
            f"{spacing:g} m makes a map of {nodes:,} nodes, too many from {readings:,} readings; "
            f"choose more than {1.01 * least:.2g} m"
        )
    x, y = (torch.arange(a, b + 1e-9 * spacing, spacing, dtype=torch.float64) for a, b in ((x0, x1), (y0, y1)))
    # In the middle of what is left over.
    return Grid(x + 0.5 * (x1 - x[-1]), y + 0.5 * (y1 - y[-1]), z, spacing)


def make_map(kriging: Kriging, grid: Grid, sender: Tensor, threshold_kbps: float | None) -> SnrMap:
    """Krige the links from a place.

    Args:
        kriging: of the readings.
        grid: where to.
        sender: [3], m, the vehicle's end of the links.
        threshold_kbps: what counts as outage below it; None for half of the map's median capacity.
    """
    places = grid.places
    distance = torch.linalg.vector_norm(places - sender, dim=-1)
    near = distance < min(NEAREST_M, 0.5 * grid.spacing)
    mean, std = kriging.predict(sender, places[~near])
    channel = kriging.channel
    capacity = channel.capacity_kbps(mean)
    threshold = threshold_kbps or 0.5 * float(capacity.median())
    outage = torch.special.ndtr((channel.budget.snr_for_dB(threshold) - mean) / std)

    def whole(values: Tensor) -> Tensor:
        return values.new_full(distance.shape, math.nan).masked_scatter(~near, values).view(len(grid.y), len(grid.x))

    return SnrMap(grid, sender, whole(mean), whole(std), whole(capacity), threshold, whole(outage))
