"""Estimators: exact recovery, NumPy's and SciPy's least squares, closed-form errors, bias and coverage, refusals."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor

from uwirl.config.compose import folder
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import ESTIMATORS, UnidentifiableError, least_squares, oracle
from uwirl.snr.measurements import Readings
from uwirl.world.acoustics import Channel
from uwirl.world.random import RandomStreams, Stream

CHANNELS = sorted(path.stem for path in (folder() / "channel").glob("*.yaml"))
DISTANCE = torch.tensor([3.0, 7.0, 12.0, 20.0, 31.0, 44.0, 60.0, 85.0], dtype=torch.float64)
DATA_SETS = 2_000


@pytest.fixture(params=CHANNELS)
def channel(request: pytest.FixtureRequest, make_config) -> Channel:
    return Channel(**asdict(make_config(f"channel={request.param}").channel))


def noise(worlds: int, seed: int = 0) -> Tensor:
    return RandomStreams.worlds(seed, worlds).normal(Stream.MEASUREMENT, 0, len(DISTANCE))


def noisy(channel: Channel, seed: int = 0) -> Readings:
    return Readings(DISTANCE, channel.mean_snr_dB(DISTANCE) + channel.rho_dB * noise(1, seed)[0])


@cache
def simulated(channel: Channel) -> list[ChannelEstimate]:
    """Estimates from independent data sets, one for each world."""
    snr = channel.mean_snr_dB(DISTANCE) + channel.rho_dB * noise(DATA_SETS, seed=1)
    return [least_squares(Readings(DISTANCE, row), channel) for row in snr]


def test_recovers_exactly_without_noise(channel: Channel):
    estimate = least_squares(Readings(DISTANCE, channel.mean_snr_dB(DISTANCE)), channel)
    assert estimate.K_dB.value == pytest.approx(channel.K_dB, abs=1e-10)
    assert estimate.n.value == pytest.approx(channel.n, abs=1e-11)
    assert estimate.rho2.value == pytest.approx(0.0, abs=1e-20)


def test_agrees_with_numpy(channel: Channel):
    readings = noisy(channel)
    H = np.stack([np.ones(len(DISTANCE)), -10.0 * np.log10(DISTANCE.numpy())], -1)
    y = (readings.snr + channel.known_loss_dB(DISTANCE)).numpy()
    theta, residual, _, _ = np.linalg.lstsq(H, y)
    estimate = least_squares(readings, channel)
    assert [estimate.K_dB.value, estimate.n.value] == pytest.approx(theta, rel=1e-12)
    assert estimate.rho2.value == pytest.approx(residual[0] / (len(y) - 2), rel=1e-9)


def test_standard_errors_agree_with_scipy(channel: Channel):
    readings = noisy(channel)
    x, y = -10.0 * torch.log10(DISTANCE), readings.snr + channel.known_loss_dB(DISTANCE)
    line = stats.linregress(x.numpy(), y.numpy())
    estimate = least_squares(readings, channel)
    assert estimate.K_dB.std == pytest.approx(line.intercept_stderr, rel=1e-9)
    assert estimate.n.std == pytest.approx(line.stderr, rel=1e-9)


def test_covariance_closed_form(channel: Channel):
    estimate = least_squares(noisy(channel), channel)
    x = -10.0 * torch.log10(DISTANCE)
    spread = float((x - x.mean()).square().sum())
    mean = float(x.mean())
    slope = estimate.rho2.value / spread
    intercept = estimate.rho2.value * (1.0 / len(x) + mean**2 / spread)
    expected = torch.tensor([[intercept, -mean * slope], [-mean * slope, slope]], dtype=torch.float64)
    torch.testing.assert_close(estimate.covariance, expected, rtol=1e-9, atol=0.0)
    assert [estimate.K_dB.std, estimate.n.std] == pytest.approx(expected.diagonal().sqrt().tolist(), rel=1e-9)


def test_planning_channel_holds_the_estimate(channel: Channel):
    estimate = least_squares(noisy(channel), channel)
    rho_dB = math.sqrt(estimate.rho2.value)
    expected = replace(channel, K_dB=estimate.K_dB.value, n=estimate.n.value, rho_dB=rho_dB)
    assert asdict(estimate.channel) == pytest.approx(asdict(expected))


def test_uses_only_what_a_vehicle_knows(channel: Channel):
    readings = noisy(channel)
    blind = least_squares(readings, replace(channel, K_dB=math.nan, n=math.nan, rho_dB=math.nan)).channel
    informed = least_squares(readings, channel).channel
    expected = [informed.K_dB, informed.n, informed.rho_dB]
    assert [blind.K_dB, blind.n, blind.rho_dB] == pytest.approx(expected, rel=1e-12)


def test_same_readings_give_the_same_bits(channel: Channel):
    readings = noisy(channel)
    held, estimates = [], set()
    for i in range(500):
        held.append(torch.zeros(i % 13 + 1))  # moves what is allocated next, as other work in the process does
        estimate = least_squares(readings, channel)
        estimates.add((estimate.K_dB.value, estimate.n.value, estimate.rho2.value))
    assert len(estimates) == 1


def test_unbiased_with_the_right_coverage(channel: Channel):
    # Eight readings leave six degrees of freedom: a normal interval would cover 90 % only.
    quantile = stats.t.ppf(0.975, len(DISTANCE) - 2)
    estimates = simulated(channel)
    for name, truth in (("K_dB", channel.K_dB), ("n", channel.n)):
        value = np.array([getattr(estimate, name).value for estimate in estimates])
        std = np.array([getattr(estimate, name).std for estimate in estimates])
        coverage = float(np.mean(np.abs(value - truth) < quantile * std))
        assert 0.93 < coverage < 0.97
        assert abs(value.mean() - truth) < 4.0 * value.std() / math.sqrt(DATA_SETS)


def test_fading_power_is_chi_squared(channel: Channel):
    freedom = len(DISTANCE) - 2
    rho2 = np.array([estimate.rho2.value for estimate in simulated(channel)])
    assert stats.kstest(rho2 * freedom / channel.rho_dB**2, stats.chi2(freedom).cdf).pvalue > 0.01


def test_fading_power_standard_error(channel: Channel):
    estimate = least_squares(noisy(channel), channel)
    # Of a Gaussian sample's variance: sqrt(2 / degrees of freedom) of it.
    assert estimate.rho2.std == pytest.approx(estimate.rho2.value * math.sqrt(2.0 / 6.0), rel=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_readings_raise(channel: Channel, count: int):
    readings = Readings(DISTANCE[:count], channel.mean_snr_dB(DISTANCE[:count]))
    with pytest.raises(UnidentifiableError, match=f"^{count} readings cannot determine .* at least 3"):
        least_squares(readings, channel)


def test_one_distance_raises(channel: Channel):
    distance = torch.full((5,), 12.5, dtype=torch.float64)
    with pytest.raises(UnidentifiableError, match=r"all 5 sensors are 12\.5 m from the vehicle"):
        least_squares(Readings(distance, channel.mean_snr_dB(distance)), channel)


def test_two_distances_suffice(channel: Channel):
    distance = torch.tensor([12.5, 12.5, 12.6], dtype=torch.float64)
    estimate = least_squares(Readings(distance, channel.mean_snr_dB(distance)), channel)
    assert estimate.n.value == pytest.approx(channel.n, abs=1e-9)


def test_oracle_is_the_truth(channel: Channel):
    estimate = oracle(noisy(channel), channel)
    assert estimate.channel == channel
    assert (estimate.K_dB.value, estimate.n.value) == (channel.K_dB, channel.n)
    assert estimate.rho2.value == channel.rho_dB**2
    assert estimate.K_dB.std == estimate.n.std == estimate.rho2.std == 0.0
    assert not bool(estimate.covariance.any())


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_estimator_contract(name: str, channel: Channel):
    estimate = ESTIMATORS[name](noisy(channel), channel)
    variances = [estimate.K_dB.std**2, estimate.n.std**2]
    assert estimate.covariance.shape == (2, 2)
    assert estimate.covariance.diagonal().tolist() == pytest.approx(variances, rel=1e-12)
    assert estimate.K_dB.identifiable
    assert estimate.n.identifiable
    assert (estimate.channel.K_dB, estimate.channel.n) == (estimate.K_dB.value, estimate.n.value)
    # What needs no estimation stays.
    kept = ("N0_dB", "bandwidth_khz", "absorption", "frequency_khz")
    assert [getattr(estimate.channel, k) for k in kept] == [getattr(channel, k) for k in kept]
