"""Kriging (32): SNR, its uncertainty, and capacity of links that were not measured.

    mean = h' theta - epsilon + k' Omega^-1 (Y + epsilon - H theta)
    variance = zeta^2 - k' Omega^-1 k + d' (H' Omega^-1 H)^-1 d,   d = h - H' Omega^-1 k

where k is the covariance (see `uwirl.world.fading`) of the link with each reading, over both ends. The last term is the
uncertainty of theta (universal kriging); without it this is a Gaussian process with a known mean.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from uwirl.snr.model import NOISELESS, design
from uwirl.world.acoustics import Channel
from uwirl.world.chunks import at_once
from uwirl.world.geometry import distances
from uwirl.world.readings import Readings

# With more readings, their covariance takes more than 0.8 GB, and its factor the same.
MAX_READINGS = 10_000
# Entries of a chunk's covariance with the readings: 2 MB, which fits into caches.
CHUNK_ENTRIES = 2**18


class Kriging:
    """Predicts the SNR of other links from readings.

    Args:
        readings: one data set.
        channel: channel parameters, numbers or tensors of one element; usually from an estimate.
        trend: whether variances include the uncertainty of theta.

    Raises:
        ValueError: more than one data set, or too many readings for the memory.
        torch.linalg.LinAlgError: repeated readings of a link, without multipath.
    """

    def __init__(self, readings: Readings, channel: Channel, trend: bool = True):
        if len(readings.snr) != 1:
            raise ValueError(f"kriging takes one data set, got {len(readings.snr)}")
        heard = ~readings.snr[0].isnan()
        transmitter, receiver = heard.nonzero().unbind(-1)
        if len(transmitter) > MAX_READINGS:
            raise ValueError(f"{len(transmitter):,} readings exceed the {MAX_READINGS:,} that memory holds; thin them")
        self.channel, self.trend = channel, trend
        self.zeta2, self.varphi, self.rho2, theta_K, theta_n = (
            torch.as_tensor(x, dtype=readings.snr.dtype, device=readings.snr.device).reshape(())
            for x in (channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2, channel.K_dB, channel.n)
        )
        self.theta = torch.stack([theta_K, theta_n])
        self.first, self.second = readings.transmitters[transmitter], readings.receivers[receiver]
        distance = torch.linalg.vector_norm(self.first - self.second, dim=-1)
        omega = self._covariance(self.first, self.second)
        omega.diagonal().add_(self.rho2.clamp_min(NOISELESS))
        self.factor = torch.linalg.cholesky(omega)
        H = design(distance)
        y = readings.snr[0][heard] + channel.budget.known_loss_dB(distance)
        # L^-1 times the residual and H, [m, 3], with Omega = L L'.
        residual = (y - H @ self.theta)[:, None]
        self.whitened = torch.linalg.solve_triangular(self.factor, torch.cat([residual, H], -1), upper=False)
        self.theta_covariance = torch.linalg.inv(self.whitened[:, 1:].mT @ self.whitened[:, 1:])
        self.alpha = torch.linalg.solve_triangular(self.factor.mT, self.whitened[:, :1], upper=True)[:, 0]

    def _covariance(self, first: Tensor, second: Tensor) -> Tensor:
        """Covariance of the shadowing on Q links with that on the readings' links, [Q, m]."""
        # Often all links share an end: then one distance to each reading is enough.
        apart = distances(first[:1] if bool((first == first[:1]).all()) else first, self.first)
        return distances(second, self.second).add_(apart).div_(-self.varphi).exp_().mul_(self.zeta2)

    def predict(self, first: Tensor, second: Tensor, multipath: bool = False) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of the SNR, [Q] each, dB.

        Args:
            first, second: ends of the links in the order of the field, [3] or [Q, 3], m.
            multipath: whether to predict a reading, with multipath, or the link's shadowed SNR.
        """
        parts = [self._predict(*ends) for ends in self._chunks(first, second)]
        mean, variance = (torch.cat(pieces) for pieces in zip(*parts, strict=True))
        return mean, (variance.clamp_min(0.0) + (self.rho2 if multipath else 0.0)).sqrt()

    def mean(self, first: Tensor, second: Tensor) -> Tensor:
        """The mean alone, [Q], dB, at a small part of the computing time: for searches."""
        return torch.cat(
            [self._trend(*ends)[0] + self._covariance(*ends) @ self.alpha for ends in self._chunks(first, second)]
        )

    def _chunks(self, first: Tensor, second: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
        count = max(len(end) if end.ndim == 2 else 1 for end in (first, second))
        first, second = (end.to(self.theta).expand(count, 3) for end in (first, second))
        chunk = at_once(max(1, CHUNK_ENTRIES // len(self.first)), first.device)
        return zip(first.split(chunk), second.split(chunk), strict=True)

    def _trend(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        """h' theta - epsilon, [Q], and h, [Q, 2]."""
        distance = torch.linalg.vector_norm(first - second, dim=-1)
        h = design(distance)
        return h @ self.theta - self.channel.budget.known_loss_dB(distance), h

    def _predict(self, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        (trend, h), k = self._trend(first, second), self._covariance(first, second)
        white = torch.linalg.solve_triangular(self.factor, k.mT, upper=False)
        projected = white.mT @ self.whitened
        mean = trend + projected[:, 0]
        variance = self.zeta2 - white.square_().sum(0)
        if self.trend:
            d = h - projected[:, 1:]
            variance = variance + ((d @ self.theta_covariance) * d).sum(-1)
        return mean, variance

    def outage(self, first: Tensor, second: Tensor, capacity_kbps: float) -> Tensor:
        """Probability, [Q], that the capacity of a link without multipath is below a value in kbit/s."""
        mean, std = self.predict(first, second)
        return torch.special.ndtr((self.channel.budget.snr_for_dB(capacity_kbps) - mean) / std)

    def relay(self, source: Tensor, destination: Tensor, position: Tensor) -> Tensor:
        """Capacity of the worse link of a relay at [Q, 3] between two nodes [3], at the expected SNR, [Q], kbit/s."""
        links = [self.mean(node, position) for node in (source, destination)]
        return self.channel.capacity_kbps(torch.minimum(*links))
