"""Shadowing of acoustic links: a Gaussian field in dB over both ends of a link.

Between the links (p, q) and (p', q') its covariance is

    zeta^2 exp(-(|p - p'| + |q - q'|) / varphi)

which is (11) if one end is fixed. The ends of a link are sorted in the order source < destination < vehicles < sensors,
so that the field is equal in both directions. It is constant within a world: repeated readings of a link have the same
shadowing. Multipath is drawn for each reading and is not part of this module.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.geometry import distances
from uwirl.world.random import RandomStreams, Stream

COSINES = 512
# Iterations of Newton's method for Kepler's equation, for which it converges monotonically.
KEPLER_STEPS = 10

# From the two ends of links, each [..., B, *, 3] in m, to their shadowing in dB.
ShadowingField = Callable[[Tensor, Tensor], Tensor]


def exact_shadowing(first: Tensor, second: Tensor, zeta_dB: float, varphi_m: float, white: Tensor) -> Tensor:
    """Joint samples, by Cholesky, of the links between each of S first ends and each of N second ends.

    Args:
        first: [S, 3], m.
        second: [N, 3], m.
        zeta_dB: standard deviation, dB.
        varphi_m: correlation distance, m.
        white: independent standard normal numbers, [..., S, N].

    Returns:
        [..., S, N], dB.

    Raises:
        torch.linalg.LinAlgError: two first or two second ends coincide.
    """
    A, E = (torch.linalg.cholesky(torch.exp(-distances(x, x) / varphi_m)) for x in (first, second))
    return zeta_dB * A @ white @ E.mT


@dataclass(frozen=True)
class Shadowing:
    """The field as a pure function of (seed, world, both ends), for missions; its cost is the same at every reading.

    It is a spectral sum

        sum_k sqrt(2 / K) zeta cos(omega_k . p + omega'_k . q + phi_k)

    where omega_k and omega'_k are independent and Cauchy distributed in three dimensions with scale 1 / varphi, whose
    characteristic function is exp(-|x| / varphi). Its covariance is exact for any K, its distribution Gaussian for
    large ones.

    Attributes:
        zeta_dB: standard deviation, dB.
        varphi_m: correlation distance, m.
        cosines: K.
    """

    zeta_dB: float
    varphi_m: float
    cosines: int = COSINES

    def realise(self, streams: RandomStreams) -> ShadowingField:
        """The field of each of B worlds, as a function of both ends."""
        K, worlds = self.cosines, len(streams.seed)
        if self.zeta_dB == 0.0:
            none = torch.zeros(worlds, 1, dtype=torch.float64, device=streams.seed.device)
            return lambda first, second: none * (first + second)[..., 0]
        draws = streams.uniform(Stream.CHANNEL, 0, 8 * K).view(worlds, 8, K)
        bands = torch.arange(K, device=draws.device)
        # Each end takes one radius from each of K equally likely bands, in its own random order: every world then has
        # the whole spectrum at both ends.
        omega = self._frequencies(bands, *draws[:, :3].unbind(1))
        omega_2 = self._frequencies(draws[:, 3].argsort(-1), *draws[:, 4:7].unbind(1))
        phase = 2.0 * math.pi * draws[:, 7]
        amplitude = self.zeta_dB * math.sqrt(2.0 / K)

        def shadowing(first: Tensor, second: Tensor) -> Tensor:
            first, second = first.to(omega.dtype), second.to(omega.dtype)
            angle = first @ omega.mT + second @ omega_2.mT + phase[:, None]
            return amplitude * torch.cos(angle).sum(-1)

        return shadowing

    def _frequencies(self, band: Tensor, u: Tensor, height: Tensor, azimuth: Tensor) -> Tensor:
        """Three-dimensional Cauchy vectors, [B, K, 3], rad/m.

        With r = tan(E / 2) the distribution function of the radius is (E - sin E) / pi, so that its quantiles solve
        Kepler's equation for an eccentricity of 1.
        """
        M = math.pi * (band + u) / self.cosines
        E = (6.0 * M).pow(1.0 / 3.0).clamp(1e-6, math.pi)
        for _ in range(KEPLER_STEPS):
            E = (E - (E - torch.sin(E) - M) / (1.0 - torch.cos(E))).clamp(1e-6, math.pi)
        radius = torch.tan(0.5 * E) / self.varphi_m
        z = 2.0 * height - 1.0
        across = torch.sqrt(1.0 - z.square())
        azimuth = 2.0 * math.pi * azimuth
        direction = torch.stack([across * torch.cos(azimuth), across * torch.sin(azimuth), z], -1)
        return radius[..., None] * direction
