"""Data sets drawn from the model of readings, and that model written out densely in NumPy, reading by reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from uwirl.snr.model import Geometry, observations
from uwirl.world.acoustics import Channel
from uwirl.world.fading import exact_shadowing
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.readings import Readings
from uwirl.world.scenario import spread_sensors

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]


def places(sensors: int, messages: int, seed: int) -> tuple[Tensor, Tensor]:
    """Transmitters [S, 3] and receivers [N, 3], spread alike."""
    both = spread_sensors(messages + sensors, seed, SOURCE, DESTINATION, torch.float64)
    return both[:messages], both[messages:]


def simulate(channel: Channel, sensors: int, messages: int = 1, sets: int = 1, seed: int = 0) -> Readings:
    """Independent data sets from the same places."""
    transmitters, receivers = places(sensors, messages, seed)
    shape = sets, messages, sensors
    streams = RandomStreams.worlds(seed, 1)
    white, multipath = (
        streams.normal(stream, 0, sets * messages * sensors).view(shape)
        for stream in (Stream.CHANNEL, Stream.MEASUREMENT)
    )
    shadowing = exact_shadowing(transmitters, receivers, channel.zeta_dB, channel.varphi_m, white)
    mean = channel.mean_snr_dB(Readings(transmitters, receivers, white).distance)
    return Readings(transmitters, receivers, mean + shadowing + channel.rho_dB * multipath)


def geometry_of(readings: Readings, channel: Channel) -> Geometry:
    """Of data sets that all have the same readings."""
    ((_, _, geometry),) = observations(readings, channel.budget)
    return geometry


@dataclass(frozen=True)
class Dense:
    """One data set of m readings.

    Attributes:
        first, second: ends of the links, [m, 3].
        y: Y + epsilon, [m].
    """

    first: np.ndarray
    second: np.ndarray
    y: np.ndarray

    @classmethod
    def of(cls, readings: Readings, channel: Channel, row: int = 0) -> Dense:
        p, q, snr = readings.transmitters.numpy(), readings.receivers.numpy(), readings.snr[row].numpy()
        i, j = np.nonzero(~np.isnan(snr))
        lengths = torch.from_numpy(np.linalg.norm(p[i] - q[j], axis=-1))
        return cls(p[i], q[j], snr[i, j] + channel.budget.known_loss_dB(lengths).numpy())

    @property
    def H(self) -> np.ndarray:
        lengths = np.linalg.norm(self.first - self.second, axis=-1)
        return np.stack([np.ones_like(lengths), -10.0 * np.log10(lengths)], -1)

    def covariance(self, zeta2: float, varphi: float, rho2: float) -> np.ndarray:
        """Omega, [m, m]."""
        apart = sum(np.linalg.norm(end[:, None] - end, axis=-1) for end in (self.first, self.second))
        return zeta2 * np.exp(-apart / varphi) + rho2 * np.eye(len(self.y))

    def theta(self, *fading: float) -> tuple[np.ndarray, np.ndarray]:
        """By generalized least squares, [2], and its covariance."""
        weighted = np.linalg.solve(self.covariance(*fading), self.H)
        covariance = np.linalg.inv(self.H.T @ weighted)
        return covariance @ weighted.T @ self.y, covariance

    def cost(self, *fading: float, theta: np.ndarray | None = None) -> float:
        """Negative log likelihood less m/2 ln(2 pi), at the best theta unless one is given."""
        theta = self.theta(*fading)[0] if theta is None else theta
        omega, residual = self.covariance(*fading), self.y - self.H @ theta
        return 0.5 * (np.linalg.slogdet(omega)[1] + residual @ np.linalg.solve(omega, residual))

    def derivatives(self, zeta2: float, varphi: float, rho2: float) -> list[np.ndarray]:
        """Of Omega by the logarithms of the fading, as central differences."""
        centre, h = np.log([zeta2, varphi, rho2]), 1e-5
        steps = [self.covariance(*np.exp(centre + s * e)) for e in h * np.eye(3) for s in (1.0, -1.0)]
        return [(high - low) / (2.0 * h) for high, low in zip(steps[::2], steps[1::2], strict=True)]
