"""The distinct links of readings: repeats of a link have the same shadowing, and differ by multipath only.

The mean of c repeats has the multipath rho^2 / c. The means, and the scatter of the repeats about them, contain all
that the readings say about the channel.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.model import design
from uwirl.world.acoustics import LinkBudget
from uwirl.world.geometry import distances
from uwirl.world.readings import Readings


class Links(NamedTuple):
    """L distinct links of B data sets with m readings each.

    Attributes:
        first, second: ends of the links, [L, 3], m.
        repeats: number of readings of each link, [L].
        H: design matrix, [L, 2].
        y: mean of Y + epsilon of each link, [B, L], dB.
        link: link of each reading, [m].
        deviation: reading minus its link's mean, [B, m], dB.
    """

    first: Tensor
    second: Tensor
    repeats: Tensor
    H: Tensor
    y: Tensor
    link: Tensor
    deviation: Tensor

    @classmethod
    def of(cls, readings: Readings, budget: LinkBudget) -> Links:
        """The links of data sets in which the same readings exist.

        Raises:
            ValueError: the data sets have different missing readings.
        """
        heard = ~readings.snr[0].isnan()
        if not torch.equal(heard.expand_as(readings.snr), ~readings.snr.isnan()):
            raise ValueError("the data sets miss different readings; give those with the same ones together")
        transmitter, receiver = heard.nonzero().unbind(-1)
        ends = torch.cat([readings.transmitters[transmitter], readings.receivers[receiver]], -1)
        distinct, link = torch.unique(ends, dim=0, return_inverse=True)
        first, second = distinct.to(readings.snr).split(3, -1)
        distance = torch.linalg.vector_norm(first - second, dim=-1)
        y = readings.snr[:, heard] + budget.known_loss_dB(distance)[link]
        repeats = torch.bincount(link).to(y)
        mean = y.new_zeros(len(y), len(repeats)).index_add(1, link, y) / repeats
        return cls(first, second, repeats, design(distance), mean, link, y - mean[:, link])

    @property
    def readings(self) -> int:
        """m."""
        return len(self.link)

    @property
    def within(self) -> Tensor:
        """Sum of squares of the repeats about their means, [B], dB^2."""
        return self.deviation.square().sum(-1)

    def apart(self, first: Tensor, second: Tensor) -> Tensor:
        """Distances of both ends of Q links, [Q, 3] each, to these, [Q, L], m."""
        # Often all links share an end: then one distance to each of these is enough.
        shared = bool((first == first[:1]).all())
        return distances(second, self.second).add_(distances(first[:1] if shared else first, self.first))
