"""Estimators: dense NumPy and SciPy, exact recovery, missing readings, what is identifiable, and refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import Dense, geometry_of, places, simulate

from uwirl.config import schema
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.snr.estimators import (
    ESTIMATORS,
    disk,
    estimate_each_vehicle,
    generalized_least_squares,
    least_squares,
    maximum_likelihood,
    oracle,
    separate,
)
from uwirl.snr.likelihood import DECREMENT
from uwirl.snr.model import UnidentifiableError
from uwirl.snr.moments import moment_fit
from uwirl.world.acoustics import Channel
from uwirl.world.readings import Readings, take_readings

# All that estimate path loss and fading.
FITTING = {
    "least_squares": least_squares,
    "generalized_least_squares": generalized_least_squares,
    "separate": separate,
    "maximum_likelihood": maximum_likelihood,
}
# `separate` goes on until all of its data sets have settled, so that one may see another round in company.
ALONE = sorted(set(ESTIMATORS) - {"separate"})
TENSORS = ("value", "covariance", "identifiable", "cost")


def same(first: ChannelEstimate, second: ChannelEstimate, rtol: float = 1e-9) -> None:
    """In all but the covariance of what is not identifiable, which means nothing."""
    assert torch.equal(first.identifiable, second.identifiable)
    identifiable = first.identifiable[:, :, None] & first.identifiable[:, None, :]
    pairs = [(x.value, x.cost, torch.where(identifiable, x.covariance, 0.0)) for x in (first, second)]
    for a, b in zip(*pairs, strict=True):
        torch.testing.assert_close(a, b, rtol=rtol, atol=1e-9)


def with_gaps(readings: Readings, share: float, seed: int = 0) -> Readings:
    """Each data set without some readings of its own."""
    draws = torch.rand(readings.snr.shape, generator=torch.Generator().manual_seed(seed))
    return replace(readings, snr=torch.where(draws < share, torch.nan, readings.snr))


def test_configuration_knows_the_estimators():
    assert schema.ESTIMATORS == (*ESTIMATORS, "oracle")


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_contract(name: str, channel: Channel):
    estimate = ESTIMATORS[name](simulate(channel, 12, 3, sets=4), channel.budget)
    assert [tuple(getattr(estimate, key).shape) for key in TENSORS] == [(4, 5), (4, 5, 5), (4, 5), (4,)]
    assert estimate.identifiable.dtype == torch.bool
    assert bool(estimate.identifiable[:, 0].all())
    assert bool(estimate.value.isfinite().all())
    assert bool((estimate.value[:, 2:] >= 0.0).all())
    torch.testing.assert_close(estimate.covariance, estimate.covariance.mT, rtol=1e-9, atol=1e-12)
    eigenvalues = torch.linalg.eigvalsh(estimate.covariance)
    assert bool((eigenvalues[:, 0] >= -1e-9 * eigenvalues[:, -1]).all())
    for k, key in enumerate(NAMES):
        value, std, identifiable = estimate.parameter(key)
        variance = estimate.covariance[:, k, k]
        assert torch.equal(value, estimate.value[:, k])
        torch.testing.assert_close(std, variance.sqrt() if k < 2 else value * variance.sqrt())
        assert torch.equal(identifiable, estimate.identifiable[:, k])
    assert torch.equal(estimate.theta, estimate.value[:, :2])
    # What needs no estimation stays.
    assert estimate.budget is estimate.channel.budget is channel.budget
    assert len(str(estimate).splitlines()) == 4


@pytest.mark.parametrize("name", FITTING)
def test_recovers_exactly_without_noise(name: str, channel: Channel):
    readings = simulate(replace(channel, zeta_dB=0.0, rho_dB=0.0), 12, 2, sets=2)
    estimate = FITTING[name](readings, channel.budget)
    assert estimate.value[:, 0].tolist() == pytest.approx([channel.K_dB] * 2, abs=1e-8)
    assert estimate.value[:, 1].tolist() == pytest.approx([channel.n] * 2, abs=1e-9)
    assert float((estimate.value[:, 2] + estimate.value[:, 4]).max()) < 1e-12


@pytest.mark.parametrize("messages", [1, 3])
def test_least_squares_is_numpys(channel: Channel, messages: int):
    """And its covariance is (H'H)^-1 H' Omega H (H'H)^-1 with the fading it found."""
    readings = simulate(channel, 12, messages, sets=5)
    estimate = least_squares(readings, channel.budget)
    for row in range(5):
        dense = Dense.of(readings, channel, row)
        theta = np.linalg.lstsq(dense.H, dense.y)[0]
        assert estimate.theta[row].tolist() == pytest.approx(theta, rel=1e-10)
        inverse = np.linalg.inv(dense.H.T @ dense.H)
        omega = dense.covariance(*estimate.value[row, 2:].tolist())
        covariance = inverse @ dense.H.T @ omega @ dense.H @ inverse
        np.testing.assert_allclose(estimate.covariance[row, :2, :2], covariance, rtol=1e-8)


@pytest.mark.parametrize("messages", [1, 3])
def test_one_step_of_generalized_least_squares_is_numpys(channel: Channel, messages: int):
    """With the moments that ordinary least squares gave."""
    readings = simulate(channel, 12, messages, sets=5)
    first, second = least_squares(readings, channel.budget), generalized_least_squares(readings, channel.budget)
    assert torch.equal(first.value[:, 2:], second.value[:, 2:])
    for row in range(5):
        theta, covariance = Dense.of(readings, channel, row).theta(*first.value[row, 2:].tolist())
        assert second.theta[row].tolist() == pytest.approx(theta, rel=1e-9)
        np.testing.assert_allclose(second.covariance[row, :2, :2], covariance, rtol=1e-7)


def test_separate_has_settled(acoustic: Channel):
    """theta is the generalized least squares of its fading, whose moments are those of what theta leaves."""
    readings = simulate(acoustic, 30, 3)
    estimate = separate(readings, acoustic.budget)
    theta, covariance = Dense.of(readings, acoustic).theta(*estimate.value[0, 2:].tolist())
    assert estimate.theta[0].tolist() == pytest.approx(theta, rel=1e-9)
    geometry = geometry_of(readings, acoustic)
    y = readings.snr + acoustic.budget.known_loss_dB(readings.distance)
    moments = moment_fit(y - (geometry.H @ estimate.theta[0])[None], geometry)
    refined, _ = Dense.of(readings, acoustic).theta(*(float(value) for value in moments))
    assert (np.abs(refined - theta) < 2e-3 * np.sqrt(covariance.diagonal())).all()


def test_moments_scale_with_the_residuals(acoustic: Channel):
    readings = simulate(replace(acoustic, K_dB=0.0, n=1e-9), 40, 2, sets=3)
    geometry = geometry_of(readings, acoustic)
    residual = readings.snr + acoustic.budget.known_loss_dB(readings.distance)
    once, twice = moment_fit(residual, geometry), moment_fit(2.0 * residual, geometry)
    torch.testing.assert_close(twice.zeta2, 4.0 * once.zeta2)
    torch.testing.assert_close(twice.varphi, once.varphi)
    torch.testing.assert_close(twice.rho2, 4.0 * once.rho2)


@pytest.mark.parametrize("name", ALONE)
def test_batch_equals_singles(name: str, channel: Channel):
    readings = simulate(channel, 12, 3, sets=5)
    together = ESTIMATORS[name](readings, channel.budget)
    for row in range(5):
        alone = ESTIMATORS[name](readings.select([row]), channel.budget)
        same(together.select([row]), alone, rtol=1e-6)


@pytest.mark.parametrize("name", FITTING)
def test_a_deaf_sensor_counts_for_nothing(name: str, channel: Channel):
    readings = simulate(channel, 14, sets=3)
    deaf = replace(readings, snr=readings.snr.clone())
    deaf.snr[:, :, [2, 9]] = torch.nan
    keep = [k for k in range(14) if k not in (2, 9)]
    fewer = Readings(readings.transmitters, readings.receivers[keep], readings.snr[:, :, keep])
    same(FITTING[name](deaf, channel.budget), FITTING[name](fewer, channel.budget))


def test_product_and_dense_likelihood_agree(acoustic: Channel):
    """A sensor that hears none of several messages: the same optimum on either way."""
    readings = simulate(acoustic, 40, 3, sets=3)
    deaf = replace(readings, snr=readings.snr.clone())
    deaf.snr[:, :, 7] = torch.nan
    keep = [k for k in range(40) if k != 7]
    fewer = Readings(readings.transmitters, readings.receivers[keep], readings.snr[:, :, keep])
    first, second = maximum_likelihood(deaf, acoustic.budget), maximum_likelihood(fewer, acoustic.budget)
    torch.testing.assert_close(first.cost, second.cost, rtol=0.0, atol=DECREMENT)
    errors = second.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    assert bool(((first.theta - second.theta).abs() < 3.0 * math.sqrt(DECREMENT) * errors[:, :2]).all())


@pytest.mark.parametrize("name", ALONE)
def test_patterns_of_gaps_come_back_in_order(name: str, channel: Channel):
    readings = with_gaps(simulate(channel, 10, 2, sets=6), 0.2)
    readings.snr[4] = torch.where(readings.snr[1].isnan(), torch.nan, readings.snr[4].nan_to_num(-3.0))
    together = ESTIMATORS[name](readings, channel.budget)
    for row in range(6):
        same(together.select([row]), ESTIMATORS[name](readings.select([row]), channel.budget), rtol=1e-6)


def test_same_readings_give_the_same_bits(channel: Channel):
    readings = simulate(channel, 12, 2)
    held, values = [], set()
    for i in range(100):
        held.append(torch.zeros(i % 13 + 1))  # moves what is allocated next, as other work in the process does
        values.add(tuple(least_squares(readings, channel.budget).value[0].tolist()))
    assert len(values) == 1


def test_papers_fading_cannot_be_told_from_one_message(paper: Channel):
    identifiable = maximum_likelihood(simulate(paper, 16, sets=200), paper.budget).identifiable
    assert bool(identifiable[:, :2].all())
    assert float((~identifiable[:, 2:4]).double().mean(0).min()) >= 0.99


def test_strong_shadowing_is_told_by_many_readings(acoustic: Channel):
    estimate = maximum_likelihood(simulate(acoustic, 256, 16, sets=3), acoustic.budget)
    assert bool(estimate.identifiable.all())
    assert "unidentifiable" not in str(estimate)


def test_unidentified_shadowing_counts_as_multipath(acoustic: Channel):
    estimate = oracle(simulate(acoustic, 8, sets=3), acoustic.budget, acoustic)
    estimate.identifiable[1, 3] = False
    channel = estimate.channel
    assert channel.zeta_dB.tolist() == pytest.approx([3.0, 0.0, 3.0])
    assert channel.rho_dB.tolist() == pytest.approx([1.0, math.sqrt(10.0), 1.0])
    assert channel.varphi_m.tolist() == [15.0] * 3
    assert "varphi (m) = unidentifiable" in str(estimate).splitlines()[1]


def test_oracle_is_the_truth(channel: Channel):
    estimate = oracle(simulate(channel, 8, sets=2), channel.budget, channel)
    truth = [channel.K_dB, channel.n, channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2]
    assert estimate.value.tolist() == [truth, truth]
    assert not bool(estimate.covariance.any())
    assert bool(estimate.identifiable.all())
    assert estimate.evaluations == 0
    assert estimate.channel.zeta_dB.tolist() == pytest.approx([channel.zeta_dB] * 2)


def test_disk_is_the_mean_whatever_the_distance(acoustic: Channel):
    readings = simulate(acoustic, 20, 2, sets=3)
    estimate = disk(readings, acoustic.budget)
    y = (readings.snr + acoustic.budget.known_loss_dB(readings.distance)).flatten(1).numpy()
    assert estimate.value[:, 0].tolist() == pytest.approx(y.mean(-1), rel=1e-12)
    assert estimate.value[:, 1:3].tolist() == [[0.0, 0.0]] * 3
    assert estimate.value[:, 4].tolist() == pytest.approx(y.var(-1, ddof=1), rel=1e-12)
    assert estimate.parameter("K_dB").std.tolist() == pytest.approx(y.std(-1, ddof=1) / math.sqrt(40), rel=1e-12)
    assert estimate.identifiable.tolist() == [[True, False, False, False, True]] * 3
    assert torch.equal(estimate.channel.rho_dB, estimate.value[:, 4].sqrt())


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@pytest.mark.parametrize("count", [1, 2])
def test_too_few_readings_raise(name: str, channel: Channel, count: int):
    readings = simulate(channel, 9)
    readings.snr[:, :, count:] = torch.nan
    with pytest.raises(UnidentifiableError, match=f"^{count} readings cannot determine .* at least 3"):
        ESTIMATORS[name](readings, channel.budget)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_one_distance_raises(name: str, channel: Channel):
    transmitter, receivers = places(5, 1, 0)
    ring = receivers - transmitter
    ring *= 12.5 / torch.linalg.vector_norm(ring, dim=-1, keepdim=True)
    readings = Readings(transmitter, transmitter + ring, torch.zeros(1, 1, 5, dtype=torch.float64))
    with pytest.raises(UnidentifiableError, match=r"all 5 readings are over 12\.5 m"):
        ESTIMATORS[name](readings, channel.budget)


def test_one_bad_data_set_of_many_raises(channel: Channel):
    readings = simulate(channel, 9, sets=3)
    readings.snr[1, :, 2:] = torch.nan
    with pytest.raises(UnidentifiableError, match=r"^2 readings"):
        maximum_likelihood(readings, channel.budget)


def test_estimate_each_vehicle_asks_every_vehicle(make_relay):
    env = make_relay("scenario.start=[[29,29,0,1],[5,5,-6,0]]", "channel=acoustic_24khz")
    readings, estimate = estimate_each_vehicle(env, maximum_likelihood)
    assert len(readings) == len(estimate.value) == 2
    for vehicle in (0, 1):
        assert torch.equal(readings[vehicle].snr, take_readings(env, vehicle).snr)
        same(estimate.select([vehicle]), maximum_likelihood(readings[vehicle], env.budget))
