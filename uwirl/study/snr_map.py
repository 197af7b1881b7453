"""A horizontal map of the predicted SNR, its uncertainty and outage, for links from one place."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.integrated_kriging import IntegratedKriging

NODES = 3500
# Margin of the map, as a fraction of the largest distance between places along an axis.
MARGIN = 0.1
# Largest product of nodes and readings, proportional to the time: some minutes.
MAX_ENTRIES = 2**28
# Closer to the sender than this, the path-loss model is not valid (K refers to 1 m).
NEAREST_M = 1.0


class Grid(NamedTuple):
    """Grid points of a map.

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
    """A map of links from one place to a grid; nan close to that place.

    Attributes:
        grid: grid points.
        sender: position of the sender, [3], m.
        mean: expected SNR, path loss and shadowing, [Y, X], dB.
        std: its standard deviation, [Y, X], dB.
        capacity: at that SNR, [Y, X], kbit/s.
        threshold: a smaller capacity counts as outage, kbit/s.
        outage: probability of outage, [Y, X].
    """

    grid: Grid
    sender: Tensor
    mean: Tensor
    std: Tensor
    capacity: Tensor
    threshold: float
    outage: Tensor


def make_grid(places: Tensor, z: float, spacing: float | None, readings: int) -> Grid:
    """A grid around places.

    Args:
        places: [k, 3], m.
        z: height of the map, m.
        spacing: m; None for about NODES nodes.
        readings: number of readings used for Kriging.

    Raises:
        ValueError: too few nodes for a map, or so many that it would take too long.
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
    x, y = (
        torch.arange(a, b + 1e-9 * spacing, spacing, dtype=torch.float64, device=places.device)
        for a, b in ((x0, x1), (y0, y1))
    )
    # The grid is centred in the covered range.
    return Grid(x + 0.5 * (x1 - x[-1]), y + 0.5 * (y1 - y[-1]), z, spacing)


def make_map(kriging: IntegratedKriging, grid: Grid, sender: Tensor, threshold_kbps: float | None) -> SnrMap:
    """Krige the links from a place.

    Args:
        kriging: predictor from the readings of one data set.
        grid: grid points.
        sender: the vehicle's end of the links, [3], m.
        threshold_kbps: a smaller capacity counts as outage; None for half of the map's median capacity.
    """
    places = grid.places
    distance = torch.linalg.vector_norm(places - sender, dim=-1)
    near = distance < min(NEAREST_M, 0.5 * grid.spacing)
    mean = kriging.mean(sender, places[~near])[0]
    capacity = kriging.budget.capacity_kbps(mean)
    threshold = threshold_kbps or 0.5 * float(capacity.median())
    limit = kriging.budget.snr_for_dB(threshold)
    (_, std), outage = kriging.predict(sender, places[~near]), kriging.below(sender, places[~near], limit)

    def whole(values: Tensor) -> Tensor:
        return values.new_full(distance.shape, math.nan).masked_scatter(~near, values).view(len(grid.y), len(grid.x))

    return SnrMap(grid, sender, whole(mean), whole(std[0]), whole(capacity), threshold, whole(outage[0]))
