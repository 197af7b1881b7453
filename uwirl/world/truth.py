"""The true channel, which vehicles do not know.

It is used to simulate readings, by the estimator `oracle`, and to evaluate missions. All other modules get readings and
a link budget. `truth_of` is the only access, and tests/test_floors.py checks which modules import it.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor

from uwirl.world.acoustics import Channel
from uwirl.world.chunks import at_once
from uwirl.world.fading import Shadowing, ShadowingField
from uwirl.world.geometry import length
from uwirl.world.random import RandomStreams

# Links whose shadowing is evaluated together: each term of its sum then fits into caches.
CHUNK = 2**10


class Truth:
    """The true channel of B worlds between two nodes.

    Args:
        channel: path loss, noise and the statistics of fading.
        source, destination: [3], m.
        streams: the worlds' random numbers.
    """

    def __init__(self, channel: Channel, source: Tensor, destination: Tensor, streams: RandomStreams):
        self.channel = channel
        self.source = source
        self.destination = destination
        self.streams = streams

    @cached_property
    def shadowing(self) -> ShadowingField:
        """Shadowing of each world's links: a function of their ends [..., B, *, 3] in the order of the field, in dB."""
        return Shadowing(float(self.channel.zeta_dB), float(self.channel.varphi_m)).realise(self.streams)

    def snr_dB(self, first: Tensor, second: Tensor) -> Tensor:
        """Shadowed SNR of links with ends [Q, 3] in the order of the field, in the first world, [Q], dB."""
        distance = length(first - second)
        chunk = at_once(CHUNK, first.device)
        ends = zip(first.split(chunk), second.split(chunk), strict=True)
        shadowing = [self.shadowing(p[None], q[None])[0] for p, q in ends]
        return self.channel.mean_snr_dB(distance) + torch.cat(shadowing)

    def chain(self, position: Tensor) -> Tensor:
        """Nodes of the communication chain in order, source first, [..., M + 2, 3], of vehicles at [..., M, 3]."""
        shape = (*position.shape[:-2], 1, 3)
        return torch.cat([self.source.expand(shape), position, self.destination.expand(shape)], -2)

    def link_snr_dB(self, position: Tensor, shadowed: bool = False) -> Tensor:
        """SNR of each link of the chain, without multipath, [..., M + 1], dB, of vehicles at [..., M, 3].

        Args:
            position: [..., M, 3], or [..., B, M, 3] where shadowed, m.
            shadowed: whether to include shadowing, or path loss alone.
        """
        chain = self.chain(position)
        snr = self.channel.mean_snr_dB(length(chain.diff(dim=-2)))
        if not shadowed or float(self.channel.zeta_dB) == 0.0:
            return snr
        # The field's ends are sorted: source < destination < vehicles.
        first, second = chain[..., :-1, :].clone(), chain[..., 1:, :].clone()
        first[..., -1, :], second[..., -1, :] = chain[..., -1, :], chain[..., -2, :]
        return snr + self.shadowing(first, second).to(snr.dtype)

    def link_capacities_kbps(self, position: Tensor, shadowed: bool = False) -> Tensor:
        """Capacity of each link, [..., M + 1], of vehicles at [..., M, 3]; the chain's is their minimum (5).

        Args:
            position: [..., M, 3], or [..., B, M, 3] where shadowed, m.
            shadowed: whether to include shadowing; path loss alone gives the mean capacity.
        """
        return self.channel.capacity_kbps(self.link_snr_dB(position, shadowed))


class _Water(Protocol):
    """The environment `Relay`, which cannot be imported here because it imports this module."""

    _truth: Truth


def truth_of(env: _Water) -> Truth:
    """The true channel of an environment."""
    return env._truth
