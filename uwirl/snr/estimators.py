"""Estimators of the channel from readings; one interface, `estimate(readings, known) -> ChannelEstimate`."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import torch

from uwirl.snr.estimate import ChannelEstimate, Parameter
from uwirl.snr.measurements import Readings
from uwirl.world.acoustics import Channel


class UnidentifiableError(ValueError):
    """The readings cannot determine the path loss."""


class Estimator(Protocol):
    """Estimates (K, n) and the fading.

    Args:
        readings: one snapshot.
        known: the channel, of which only what a vehicle knows beforehand (N0, bandwidth, absorption) may be used.
    """

    def __call__(self, readings: Readings, known: Channel) -> ChannelEstimate: ...


def least_squares(readings: Readings, known: Channel) -> ChannelEstimate:
    """Ordinary least squares of Y + epsilon = H theta + fading, H = [1, -10 log10 d]    (10).

    The fading's power is the unbiased residual variance, with the standard error of a Gaussian sample's variance.

    Raises:
        UnidentifiableError: fewer than three readings, or all from one distance, which leaves the slope undetermined.
    """
    count = len(readings.distance)
    if count < 3:
        raise UnidentifiableError(f"{count} readings cannot determine K, n and the fading: at least 3 are needed")
    log_distance = -10.0 * torch.log10(readings.distance)
    if float(log_distance.max() - log_distance.min()) < 1e-9:
        raise UnidentifiableError(
            f"all {count} sensors are {float(readings.distance[0]):g} m from the vehicle: "
            "K and n cannot be told apart from one distance"
        )
    H = torch.stack([torch.ones_like(log_distance), log_distance], -1)
    y = readings.snr + known.known_loss_dB(readings.distance)
    # gels, because the last bits of the default driver depend on where in memory the data lie.
    theta = torch.linalg.lstsq(H, y[:, None], driver="gels").solution[:, 0]
    residual = y - H @ theta
    freedom = count - 2
    rho2 = residual.square().sum() / freedom
    covariance = rho2 * torch.linalg.inv(H.T @ H)
    K, n = theta.tolist()
    K_std, n_std = covariance.diagonal().sqrt().tolist()
    return ChannelEstimate(
        channel=replace(known, K_dB=K, n=n, rho_dB=float(rho2.sqrt())),
        K_dB=Parameter(K, K_std),
        n=Parameter(n, n_std),
        rho2=Parameter(float(rho2), float(rho2) * (2.0 / freedom) ** 0.5),
        covariance=covariance,
    )


def oracle(readings: Readings, known: Channel) -> ChannelEstimate:
    """The truth, for ablations."""
    return ChannelEstimate(
        channel=known,
        K_dB=Parameter(float(known.K_dB), 0.0),
        n=Parameter(float(known.n), 0.0),
        rho2=Parameter(known.rho_dB**2, 0.0),
        covariance=torch.zeros(2, 2, dtype=torch.float64),
    )


ESTIMATORS: dict[str, Estimator] = {"least_squares": least_squares, "oracle": oracle}
