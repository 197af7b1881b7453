"""Predictions without knowing the fading: against numerical integration, against plug-in kriging, and over worlds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import Dense, places, simulate
from scipy import integrate, stats
from torch import Tensor

from uwirl.snr.estimators import maximum_likelihood
from uwirl.snr.integrated_kriging import IntegratedKriging
from uwirl.snr.kriging import Kriging
from uwirl.snr.links import Links
from uwirl.snr.model import Fading
from uwirl.snr.posterior import FadingPosterior
from uwirl.world.acoustics import Channel
from uwirl.world.readings import Readings

QUERIES = places(6, 1, 77)[1]


def pinged(channel: Channel, sensors: int, pings: int, sets: int = 1, seed: int = 0) -> Readings:
    """The same links read several times."""
    once = simulate(replace(channel, rho_dB=0.0), sensors, 1, sets, seed)
    generator = torch.Generator().manual_seed(seed)
    multipath = channel.rho_dB * torch.randn(sets, pings, sensors, generator=generator, dtype=torch.float64)
    return Readings(once.transmitters.expand(pings, 3), once.receivers, once.snr + multipath)


class Integral:
    """Simpson's rule over ln varphi, ln gamma and ln rho^2, with Omega of all readings; theta has a closed form."""

    def __init__(self, readings: Readings, channel: Channel):
        self.dense = Dense.of(readings, channel)
        span = max(np.linalg.norm(a - b) for a in self.dense.second for b in self.dense.second)
        self.axes = np.linspace(np.log(0.004 * span), np.log(span), 41), np.linspace(-9.0, 9.0, 61)
        self.log_rho2 = np.linspace(-9.0, 9.0, 181)
        self.nodes = [[self._node(math.exp(v), math.exp(g)) for g in self.axes[1]] for v in self.axes[0]]
        weight = np.array([[node[0] for node in row] for row in self.nodes])
        self.weight = np.exp(weight - weight.max())
        self.total = self._over(np.ones_like(self.weight))

    def _node(self, varphi: float, gamma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
        y, H, M = self.dense.y, self.dense.H, self.dense.covariance(gamma, varphi, 1.0)
        information = H.T @ np.linalg.solve(M, H)
        theta = np.linalg.solve(information, H.T @ np.linalg.solve(M, y))
        squares = (y - H @ theta) @ np.linalg.solve(M, y - H @ theta)
        logdet = np.linalg.slogdet(M)[1] + np.linalg.slogdet(information)[1]
        freedom = len(y) - 2
        return -0.5 * (freedom * self.log_rho2 + squares * np.exp(-self.log_rho2) + logdet), M, theta, varphi, gamma

    def _over(self, values: np.ndarray) -> float:
        for x in (self.log_rho2, *self.axes[::-1]):
            values = integrate.simpson((self.weight * values) if values.ndim == 3 else values, x=x)
        return float(values)

    def expectation(self, values: np.ndarray) -> float:
        """Of [41, 61, 181]."""
        return self._over(values) / self.total

    def predict(self, first: np.ndarray, second: np.ndarray, known: float, snr: float) -> tuple[float, float, float]:
        """Mean, standard deviation, and the probability of less than an SNR, of one link."""
        both = Dense(np.vstack([self.dense.first, first]), np.vstack([self.dense.second, second]), np.zeros(1))
        H, h = self.dense.H, both.H[-1]
        mean, variance = np.empty(self.weight.shape), np.empty(self.weight.shape)
        for i, row in enumerate(self.nodes):
            for j, (_, M, theta, varphi, gamma) in enumerate(row):
                apart = np.linalg.norm(self.dense.first - first, axis=-1) + np.linalg.norm(
                    self.dense.second - second, axis=-1
                )
                k = gamma * np.exp(-apart / varphi)
                pull = np.linalg.solve(M, k)
                d = h - pull @ H
                inverse = np.linalg.inv(H.T @ np.linalg.solve(M, H))
                mean[i, j] = h @ theta + pull @ (self.dense.y - H @ theta) - known
                variance[i, j] = np.exp(self.log_rho2) * (gamma - pull @ k + d @ inverse @ d)
        centre = self.expectation(mean)
        total = self.expectation(variance + (mean - centre) ** 2)
        return centre, math.sqrt(total), self.expectation(stats.norm.cdf(snr, mean, np.sqrt(variance)))


def test_numerical_integration(acoustic: Channel):
    """Five stations, two of them read twice, and a place between them."""
    readings = pinged(acoustic, 5, 2)
    readings.snr[0, 1, :3] = torch.nan
    node, place = readings.transmitters[0], QUERIES[0]
    known = float(acoustic.budget.known_loss_dB(torch.linalg.vector_norm(node - place)))
    threshold = float(readings.snr[0, 0].mean()) - 3.0
    integral = Integral(readings, acoustic)
    expected = integral.predict(node.numpy(), place.numpy(), known, threshold)
    kriging = IntegratedKriging.of(readings, acoustic.budget)
    mean, std = kriging.predict(node, place)
    found = [float(x) for x in (mean, std, kriging.below(node, place, threshold))]
    assert found == pytest.approx(expected, rel=5e-3)
    assert float(kriging.mean(node, place)) == pytest.approx(float(mean), abs=1e-9)
    # zeta^2 is gamma rho^2; a sum over nodes is as exact as its steps.
    log_zeta2 = np.broadcast_to(integral.axes[1][:, None] + integral.log_rho2, integral.weight.shape)
    for end, share in zip(kriging.posterior.intervals()[0, 0].tolist(), (0.025, 0.975), strict=True):
        assert integral.expectation(log_zeta2 < math.log(end)) == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("messages", [1, 3])
def test_known_fading_is_universal_kriging(channel: Channel, messages: int):
    """With theta by generalized least squares; a missing reading, and links from elsewhere."""
    readings = simulate(channel, 20, messages)
    readings.snr[0, 0, 3] = torch.nan
    fading = Fading(
        *(torch.tensor(x, dtype=torch.float64) for x in (channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2))
    )
    K, n = Dense.of(readings, channel).theta(*(float(x) for x in fading))[0].tolist()
    plugged = Kriging(readings, replace(channel, K_dB=K, n=n))
    kriging = IntegratedKriging(FadingPosterior.known(Links.of(readings, channel.budget), fading), channel.budget)
    for first in (readings.transmitters[0], places(1, 6, 5)[0]):
        for multipath in (False, True):
            expected = plugged.predict(first, QUERIES, multipath)
            found = kriging.predict(first, QUERIES, multipath)
            for a, b in zip(found, expected, strict=True):
                torch.testing.assert_close(a[0], b, rtol=1e-8, atol=1e-8)
        outage = kriging.below(first, QUERIES, 10.0)[0]
        expected = torch.special.ndtr((10.0 - plugged.predict(first, QUERIES)[0]) / plugged.predict(first, QUERIES)[1])
        torch.testing.assert_close(outage, expected, rtol=1e-6, atol=1e-9)


def test_many_readings_leave_nothing_open(acoustic: Channel):
    """6 messages to 64 sensors: predictions become the estimated channel's, within its standard error of zeta."""
    readings = simulate(acoustic, 64, 6)
    node = readings.transmitters[0]
    estimate = maximum_likelihood(readings, acoustic.budget)
    mean, std = Kriging(readings, estimate.channel).predict(node, QUERIES)
    found, width = (x[0] for x in IntegratedKriging.of(readings, acoustic.budget).predict(node, QUERIES))
    assert float((found - mean).abs().max()) < 0.05 * float(std.min())
    relative = 0.5 * float(estimate.covariance[0, 2, 2].sqrt())
    assert relative < 0.08
    torch.testing.assert_close(width, std, rtol=relative, atol=0.0)


def test_a_batch_equals_its_singles(acoustic: Channel):
    """On one grid, with a place that nobody heard of in any of them."""
    readings = pinged(acoustic, 8, 3, sets=3)
    readings.snr[:, 2, 5] = torch.nan
    grid = FadingPosterior.coarse(Links.of(readings, acoustic.budget)).refined()
    batch, node = IntegratedKriging(grid, acoustic.budget), readings.transmitters[0]
    whole = (*batch.predict(node, QUERIES), batch.below(node, QUERIES, 12.0), batch.posterior.intervals())
    for row in range(3):
        links = Links.of(readings.select(slice(row, row + 1)), acoustic.budget)
        single = IntegratedKriging(FadingPosterior.on(links, grid.log_varphi, grid.log_ratio), acoustic.budget)
        alone = (*single.predict(node, QUERIES), single.below(node, QUERIES, 12.0), single.posterior.intervals())
        for a, b in zip(whole, alone, strict=True):
            torch.testing.assert_close(a[row], b[0], rtol=1e-9, atol=1e-9)


def test_different_gaps_are_refused(acoustic: Channel):
    readings = simulate(acoustic, 8, sets=2)
    readings.snr[1, 0, 3] = torch.nan
    with pytest.raises(ValueError, match="the data sets miss different readings"):
        Links.of(readings, acoustic.budget)


def covered(channel: Channel, sensors: int, pings: int, layouts: int) -> tuple[float, float]:
    """Shares of unmeasured links, and of readings there, within two standard deviations."""
    inside: list[Tensor] = []
    for seed in range(layouts):
        truth = simulate(replace(channel, rho_dB=0.0), sensors + 40, 1, 20, seed)
        generator = torch.Generator().manual_seed(seed)
        noise = channel.rho_dB * torch.randn(20, pings, sensors + 40, generator=generator, dtype=torch.float64)
        node, near, far = truth.transmitters, truth.receivers[:sensors], truth.receivers[sensors:]
        readings = Readings(node.expand(pings, 3), near, (truth.snr + noise)[..., :sensors])
        kriging = IntegratedKriging.of(readings, channel.budget)
        link = truth.snr[:, 0, sensors:]
        for multipath, there in ((False, link), (True, link + noise[:, 0, sensors:])):
            mean, std = kriging.predict(node[0], far, multipath)
            inside.append(((there - mean).abs() < 2.0 * std).double().mean())
    return float(torch.stack(inside[::2]).mean()), float(torch.stack(inside[1::2]).mean())


def test_standing_stations_do_not_make_a_map_sure(acoustic: Channel):
    """Eight stations, twelve pings: plug-in kriging has 12 % of links within two standard deviations."""
    link, reading = covered(acoustic, 8, 12, 20)
    assert 0.90 < link < 0.97
    assert 0.90 < reading < 0.97


def test_one_message_to_sixteen_sensors(channel: Channel):
    """Readings are as likely as they are said to be; of links alone no less, as multipath may be shadowing."""
    link, reading = covered(channel, 16, 1, 20)
    assert link > 0.88
    assert 0.93 < reading < 0.97
