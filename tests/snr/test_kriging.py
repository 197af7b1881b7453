"""Kriging against scikit-learn and dense NumPy; limits near and far from readings; chunks, outage and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import Dense, places, simulate
from scipy import stats
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel
from torch import Tensor

from uwirl.snr import kriging
from uwirl.snr.estimators import maximum_likelihood
from uwirl.snr.kriging import Kriging
from uwirl.world.acoustics import Channel
from uwirl.world.readings import Readings, take_readings
from uwirl.world.scenario import spread_sensors
from uwirl.world.truth import truth_of

# Where nobody listens.
QUERIES = spread_sensors(50, 77, [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0], torch.float64)


def fading_of(channel: Channel) -> tuple[float, float, float]:
    return channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2


def exactly(channel: Channel) -> Channel:
    """With parameters like an estimate's, of one element each."""
    names = ("K_dB", "n", "zeta_dB", "varphi_m", "rho_dB")
    return replace(channel, **{name: torch.tensor([getattr(channel, name)], dtype=torch.float64) for name in names})


def dense_prediction(
    readings: Readings, channel: Channel, first: Tensor, second: Tensor, trend: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance from the covariance of readings and queries together."""
    dense, (zeta2, varphi, rho2), theta = Dense.of(readings, channel), fading_of(channel), [channel.K_dB, channel.n]
    p, q = first.expand_as(second).numpy(), second.numpy()
    both = Dense(np.concatenate([dense.first, p]), np.concatenate([dense.second, q]), np.zeros(len(dense.y) + len(q)))
    m = len(dense.y)
    k = both.covariance(zeta2, varphi, 0.0)[m:, :m]
    omega, h = dense.covariance(zeta2, varphi, rho2), both.H[m:]
    weights = np.linalg.solve(omega, k.T).T
    known = channel.budget.known_loss_dB(torch.from_numpy(np.linalg.norm(p - q, axis=-1))).numpy()
    mean = h @ theta + weights @ (dense.y - dense.H @ theta) - known
    variance = zeta2 - (weights * k).sum(-1)
    if trend:
        d = h - weights @ dense.H
        variance += ((d @ dense.theta(zeta2, varphi, rho2)[1]) * d).sum(-1)
    return mean, variance


@pytest.mark.parametrize("multipath", [False, True])
def test_simple_kriging_is_scikit_learns(channel: Channel, multipath: bool):
    """A Gaussian process of the residuals over the moving end, one node being fixed."""
    readings = simulate(channel, 40)
    dense, (zeta2, varphi, rho2) = Dense.of(readings, channel), fading_of(channel)
    kernel = ConstantKernel(zeta2, "fixed") * Matern(varphi, "fixed", nu=0.5) + WhiteKernel(rho2, "fixed")
    process = GaussianProcessRegressor(kernel, alpha=0.0, optimizer=None)
    process.fit(dense.second, dense.y - dense.H @ [channel.K_dB, channel.n])
    residual, std = process.predict(QUERIES.numpy(), return_std=True)
    node = readings.transmitters[0]
    path_loss = channel.mean_snr_dB(torch.linalg.vector_norm(QUERIES - node, dim=-1)).numpy()
    mean, own = Kriging(readings, exactly(channel), trend=False).predict(node, QUERIES, multipath)
    # scikit-learn's variance is of a reading.
    np.testing.assert_allclose(mean.numpy() - path_loss, residual, rtol=0.0, atol=1e-12 * np.abs(path_loss).max())
    np.testing.assert_allclose(
        own.square(), std**2 - (0.0 if multipath else rho2), rtol=0.0, atol=1e-12 * zeta2 + 1e-15
    )


@pytest.mark.parametrize("trend", [False, True])
@pytest.mark.parametrize("messages", [1, 3])
def test_dense_formulas(channel: Channel, messages: int, trend: bool):
    """Over both ends, of links from one of the transmitters and from elsewhere."""
    readings = simulate(channel, 20, messages)
    readings.snr[0, 0, 3] = torch.nan
    prediction = Kriging(readings, exactly(channel), trend)
    elsewhere = places(len(QUERIES), 1, 5)[1]
    for first in (readings.transmitters[0], elsewhere):
        mean, variance = dense_prediction(readings, channel, first, QUERIES, trend)
        own, std = prediction.predict(first, QUERIES)
        np.testing.assert_allclose(own, mean, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(std.square(), variance, rtol=1e-9, atol=1e-13)


def test_uncertain_path_loss_widens(channel: Channel):
    readings = simulate(channel, 20, 2)
    node = readings.transmitters[0]
    (simple_mean, simple), (mean, universal) = (
        Kriging(readings, exactly(channel), trend).predict(node, QUERIES) for trend in (False, True)
    )
    assert torch.equal(simple_mean, mean)
    assert bool((universal > simple).all())


def test_multipath_adds_its_power(channel: Channel):
    readings = simulate(channel, 20)
    prediction, node = Kriging(readings, exactly(channel)), readings.transmitters[0]
    (_, latent), (_, reading) = (prediction.predict(node, QUERIES, multipath) for multipath in (False, True))
    torch.testing.assert_close(reading.square() - latent.square(), torch.full_like(latent, channel.rho_dB**2))


def test_without_multipath_it_goes_through_the_readings(acoustic: Channel):
    clean = replace(acoustic, rho_dB=0.0)
    readings = simulate(clean, 12, 3)
    first = readings.transmitters.repeat_interleave(12, 0)
    mean, std = Kriging(readings, exactly(clean)).predict(first, readings.receivers.repeat(3, 1))
    torch.testing.assert_close(mean, readings.snr.flatten(), rtol=0.0, atol=1e-9)
    assert float(std.max()) < 1e-5


def test_far_from_all_readings_only_path_loss_is_left(acoustic: Channel):
    readings = simulate(acoustic, 20, 2)
    far = torch.tensor([[3_000.0, 0.0, -8.0], [0.0, -4_000.0, -8.0]], dtype=torch.float64)
    node = readings.transmitters[0]
    mean, std = Kriging(readings, exactly(acoustic), trend=False).predict(node, far)
    distance = torch.linalg.vector_norm(far - node, dim=-1)
    torch.testing.assert_close(mean, acoustic.mean_snr_dB(distance), rtol=1e-12, atol=0.0)
    torch.testing.assert_close(std, torch.full_like(std, acoustic.zeta_dB), rtol=1e-12, atol=0.0)


def test_no_shadowing_predicts_the_path_loss(acoustic: Channel):
    still = replace(acoustic, zeta_dB=0.0)
    readings = simulate(still, 20)
    mean, std = Kriging(readings, exactly(still), trend=False).predict(readings.transmitters[0], QUERIES)
    distance = torch.linalg.vector_norm(QUERIES - readings.transmitters[0], dim=-1)
    torch.testing.assert_close(mean, still.mean_snr_dB(distance), rtol=1e-12, atol=0.0)
    assert not bool(std.any())


def test_chunks_equal_one_piece(acoustic: Channel, monkeypatch: pytest.MonkeyPatch):
    readings = simulate(acoustic, 20, 2)
    prediction, node = Kriging(readings, exactly(acoustic)), readings.transmitters[0]
    whole = prediction.predict(node, QUERIES)
    swapped = prediction.predict(QUERIES, node)
    monkeypatch.setattr(kriging, "CHUNK_ENTRIES", 7 * 40 + 1)
    torch.testing.assert_close(prediction.predict(node, QUERIES), whole, rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(prediction.predict(QUERIES, node), swapped, rtol=1e-12, atol=1e-12)


def test_an_estimate_will_do(acoustic: Channel):
    readings = simulate(acoustic, 40, 2)
    estimated = maximum_likelihood(readings, acoustic.budget).channel
    numbers = {name: float(getattr(estimated, name)) for name in ("K_dB", "n", "zeta_dB", "varphi_m", "rho_dB")}
    node = readings.transmitters[0]
    own, std = Kriging(readings, estimated).predict(node, QUERIES)
    mean, variance = dense_prediction(readings, replace(acoustic, **numbers), node, QUERIES, trend=True)
    np.testing.assert_allclose(own, mean, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(std.square(), variance, rtol=1e-8)


def test_outage_is_a_normal_probability(channel: Channel):
    readings = simulate(channel, 20, 2)
    prediction, node = Kriging(readings, exactly(channel)), readings.transmitters[0]
    mean, std = (x.numpy() for x in prediction.predict(node, QUERIES))
    before = np.zeros(len(QUERIES))
    for capacity in (5.0, 20.0, 60.0, 100.0):
        snr = 10.0 * np.log10(2.0 ** (capacity / channel.budget.bandwidth_khz) - 1.0)
        outage = prediction.outage(node, QUERIES, capacity).numpy()
        np.testing.assert_allclose(outage, stats.norm.cdf(snr, mean, std), rtol=1e-9, atol=1e-15)
        assert (outage >= before).all()
        before = outage
    assert before.max() > 0.5


def test_relay_carries_what_its_worse_link_does(acoustic: Channel):
    readings = simulate(acoustic, 30, 2)
    prediction, (source, destination) = Kriging(readings, exactly(acoustic)), readings.transmitters
    links = [prediction.predict(node, QUERIES)[0] for node in (source, destination)]
    expected = torch.minimum(*(acoustic.capacity_kbps(snr) for snr in links))
    torch.testing.assert_close(prediction.relay(source, destination, QUERIES), expected)


def test_calibrated_over_worlds(acoustic: Channel):
    """Withheld readings over their predicted standard deviation are standard normal."""
    readings = simulate(acoustic, 60, sets=300)
    scores, known = [], exactly(acoustic)
    for row in range(300):
        snr = readings.snr[row : row + 1, :, :59]
        prediction = Kriging(Readings(readings.transmitters, readings.receivers[:59], snr), known, trend=False)
        mean, std = prediction.predict(readings.transmitters[0], readings.receivers[59], multipath=True)
        scores.append(float((readings.snr[row, 0, 59] - mean) / std))
    assert stats.kstest(scores, stats.norm.cdf).pvalue > 0.01


def test_several_data_sets_are_refused(channel: Channel):
    with pytest.raises(ValueError, match="kriging takes one data set, got 2"):
        Kriging(simulate(channel, 8, sets=2), channel)


def test_too_many_readings_are_refused(channel: Channel, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(kriging, "MAX_READINGS", 23)
    with pytest.raises(ValueError, match=r"^24 readings exceed the 23 that memory holds; thin them"):
        Kriging(simulate(channel, 8, 3), channel)
    readings = simulate(channel, 8, 3)
    readings.snr[0, 1, 2] = torch.nan
    assert len(Kriging(readings, exactly(channel)).first) == 23


def test_one_link_twice_without_multipath_is_refused(acoustic: Channel):
    clean = replace(acoustic, rho_dB=0.0)
    p, q = places(4, 1, 0)
    q[3] = q[1]
    with pytest.raises(torch.linalg.LinAlgError):
        Kriging(Readings(p, q, torch.zeros(1, 1, 4, dtype=torch.float64)), clean)


def test_python_numbers_keep_their_digits(make_relay):
    env = make_relay("channel=paper")
    channel = truth_of(env).channel
    assert float(Kriging(take_readings(env), channel).varphi) == channel.varphi_m
