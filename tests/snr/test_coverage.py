"""Maximum likelihood over many data sets and layouts: errors against the Cramer-Rao bound, and what intervals cover."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import torch
from dense import geometry_of, simulate
from scipy import stats

from uwirl.snr.estimators import Estimator, least_squares, maximum_likelihood
from uwirl.snr.information import cramer_rao_bound
from uwirl.snr.model import Fading
from uwirl.world.acoustics import Channel


class Pooled(NamedTuple):
    """Errors of K, n and the logarithms of the fading, over all layouts, [sets, 5].

    Attributes:
        bounds: over the Cramer-Rao bound's standard errors.
        claims: over the estimate's own.
    """

    bounds: np.ndarray
    claims: np.ndarray

    @property
    def inefficiency(self) -> np.ndarray:
        """Root mean square error over that of the bound, [5]."""
        return np.sqrt(np.square(self.bounds).mean(0))

    def coverage(self, quantile: float) -> np.ndarray:
        """Of intervals of so many standard errors either way, [5]."""
        return (np.abs(self.claims) < quantile).mean(0)


def pooled(estimator: Estimator, channel: Channel, sensors: int, messages: int, sets: int, layouts: int) -> Pooled:
    truth = torch.tensor([channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2], dtype=torch.float64)
    bounds, claims = [], []
    for seed in range(layouts):
        readings = simulate(channel, sensors, messages, sets // layouts, seed)
        estimate = estimator(readings, channel.budget)
        least = cramer_rao_bound(geometry_of(readings, channel), Fading(*truth)).diagonal().sqrt()
        theta = estimate.theta - torch.tensor([channel.K_dB, channel.n], dtype=torch.float64)
        error = torch.cat([theta, estimate.value[:, 2:].log() - truth.log()], -1)
        bounds.append(error / least)
        claims.append(error / estimate.covariance.diagonal(dim1=-2, dim2=-1).sqrt())
    return Pooled(torch.cat(bounds).numpy(), torch.cat(claims).numpy())


def student_t(readings: int) -> float:
    return float(stats.t.ppf(0.975, readings - 2))


def test_path_loss_from_sixteen_readings(paper: Channel):
    """Nearly as good as any estimator can be; intervals are a little wide, as shadowing is not ruled out."""
    result = pooled(maximum_likelihood, paper, 16, 1, sets=2_000, layouts=8)
    assert (result.inefficiency[:2] < 1.10).all()
    assert (result.coverage(student_t(16))[:2] > 0.93).all()
    standard_error = result.bounds[:, :2].std(0) / np.sqrt(2_000)
    assert (np.abs(result.bounds[:, :2].mean(0)) < 4.0 * standard_error).all()


def test_path_loss_from_sixty_four_readings(channel: Channel):
    result = pooled(maximum_likelihood, channel, 64, 1, sets=800, layouts=8)
    coverage = result.coverage(student_t(64))[:2]
    assert (result.inefficiency[:2] < 1.10).all()
    assert (coverage > 0.93).all()
    assert (coverage < 0.97).all()


@pytest.mark.slow
@pytest.mark.parametrize(("sensors", "sets", "layouts"), [(64, 4_000, 20), (256, 2_000, 20)])
def test_path_loss(channel: Channel, sensors: int, sets: int, layouts: int):
    result = pooled(maximum_likelihood, channel, sensors, 1, sets, layouts)
    coverage = result.coverage(student_t(sensors))[:2]
    assert (result.inefficiency[:2] < 1.10).all()
    assert (coverage > 0.93).all()
    assert (coverage < 0.97).all()


@pytest.mark.slow
def test_path_loss_from_sixteen_readings_in_shadow(acoustic: Channel):
    result = pooled(maximum_likelihood, acoustic, 16, 1, sets=4_000, layouts=40)
    assert (result.inefficiency[:2] < 1.10).all()


@pytest.mark.slow
def test_fading_from_sixteen_messages(acoustic: Channel):
    """256 sensors: at the bound, with honest intervals, and least squares far from it."""
    best, plain = (pooled(f, acoustic, 256, 16, sets=200, layouts=4) for f in (maximum_likelihood, least_squares))
    coverage = best.coverage(float(stats.norm.ppf(0.975)))[2:]
    assert (best.inefficiency < 1.20).all()
    assert (coverage > 0.92).all()
    assert (coverage < 0.98).all()
    assert (plain.inefficiency[2:] > 1.5 * best.inefficiency[2:]).all()
