"""Residuals against kriging without the link, offsets against dense least squares, and false and true alarms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import Dense
from scipy import stats

from uwirl.snr.diagnostics import Diagnostics
from uwirl.snr.diagnostics import diagnose as diagnose_with
from uwirl.snr.intervals import student_t
from uwirl.snr.kriging import Kriging
from uwirl.snr.links import Links
from uwirl.snr.model import Fading
from uwirl.snr.posterior import FadingPosterior
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.fading import exact_shadowing
from uwirl.world.readings import Readings

TRUTH = Channel(LinkBudget(-104.0, 6.0, "thorp", 24.0), -60.0, 2.0, zeta_dB=3.0, varphi_m=15.0, rho_dB=1.0)
FADING = 9.0, 15.0, 1.0
MESSAGES, SENSORS = 8, 25


def simulate(seed: int = 0, missing: int = 0) -> Readings:
    generator = torch.Generator().manual_seed(seed)
    kind = {"generator": generator, "dtype": torch.float64}
    transmitters, receivers = 60.0 * torch.rand(MESSAGES, 3, **kind), 60.0 * torch.rand(SENSORS, 3, **kind)
    readings = Readings(transmitters, receivers, torch.zeros(1, MESSAGES, SENSORS, dtype=torch.float64))
    white, multipath = torch.randn(2, 1, MESSAGES, SENSORS, **kind)
    shadowing = exact_shadowing(transmitters, receivers, TRUTH.zeta_dB, TRUTH.varphi_m, white)
    snr = TRUTH.mean_snr_dB(readings.distance) + shadowing + TRUTH.rho_dB * multipath
    snr.view(-1)[torch.randperm(snr.numel(), generator=generator)[:missing]] = math.nan
    return replace(readings, snr=snr)


def diagnose(readings: Readings, truth: Channel) -> Diagnostics:
    """With the true fading."""
    fading = Fading(*(torch.tensor(x, dtype=torch.float64) for x in FADING))
    return diagnose_with(readings, FadingPosterior.known(Links.of(readings, truth.budget), fading))


def universal(readings: Readings) -> Kriging:
    """With K and n by generalized least squares, written out."""
    heard = ~readings.snr[0].isnan()
    transmitter, receiver = heard.nonzero().unbind(-1)
    distance = readings.distance[heard]
    apart = torch.cdist(readings.transmitters, readings.transmitters)[transmitter[:, None], transmitter]
    apart = apart + torch.cdist(readings.receivers, readings.receivers)[receiver[:, None], receiver]
    omega = TRUTH.zeta_dB**2 * torch.exp(-apart / TRUTH.varphi_m) + TRUTH.rho_dB**2 * torch.eye(len(apart)).double()
    H = torch.stack([torch.ones_like(distance), -10.0 * torch.log10(distance)], -1)
    weighted = torch.linalg.solve(omega, H).mT
    y = readings.snr[0][heard] + TRUTH.budget.known_loss_dB(distance)
    K, n = torch.linalg.solve(weighted @ H, weighted @ y)
    return Kriging(readings, replace(TRUTH, K_dB=K, n=n))


@pytest.mark.parametrize("missing", [0, 60])
def test_residuals_are_those_of_kriging_without_the_reading(missing: int):
    readings = simulate(missing=missing)
    found = diagnose(readings, TRUTH)
    places = (~readings.snr[0].isnan()).nonzero().tolist()
    assert len(found.residual) == len(places) == MESSAGES * SENSORS - missing
    for k in (0, 7, 50, len(places) - 1):
        s, j = places[k]
        without = readings.snr.clone()
        without[0, s, j] = math.nan
        kriging = universal(replace(readings, snr=without))
        mean, std = kriging.predict(readings.transmitters[s], readings.receivers[j], multipath=True)
        residual = float(readings.snr[0, s, j] - mean)
        assert float(found.residual[k]) == pytest.approx(residual, abs=1e-9)
        assert float(found.standardized[k]) == pytest.approx(residual / float(std), abs=1e-9)


def test_readings_of_a_link_are_left_out_together():
    """Three pings of each message: all are held against what the other links predict."""
    readings = simulate(missing=9)
    noise = torch.randn(3, 1, MESSAGES, SENSORS, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    pings = readings.snr + noise
    repeated = replace(
        readings, transmitters=readings.transmitters.repeat(3, 1), snr=pings.flatten(0, 1)[None].flatten(1, 2)
    )
    found = diagnose(repeated, TRUTH)
    s, j = 2, 7
    without = repeated.snr.clone()
    without[0, s::MESSAGES, j] = math.nan
    mean, std = universal(replace(repeated, snr=without)).predict(
        readings.transmitters[s], readings.receivers[j], multipath=True
    )
    places = (~repeated.snr[0].isnan()).nonzero().tolist()
    for ping in range(3):
        k = places.index([s + ping * MESSAGES, j])
        residual = float(pings[ping, 0, s, j] - mean)
        assert float(found.residual[k]) == pytest.approx(residual, abs=1e-9)
        assert float(found.standardized[k]) == pytest.approx(residual / float(std), abs=1e-9)
    assert found.links == MESSAGES * SENSORS - 9
    assert len(found.whitened) == 3 * found.links - 2


def test_offsets_by_dense_least_squares():
    """Of a sensor and of one of two readings of a link, as one more column of the design matrix."""
    readings = simulate(missing=40)
    transmitters = torch.cat([readings.transmitters, readings.transmitters[:1]])
    readings = replace(readings, transmitters=transmitters, snr=torch.cat([readings.snr, readings.snr[:, :1] + 1.5], 1))
    found, dense = diagnose(readings, TRUTH), Dense.of(readings, TRUTH)
    receiver = np.nonzero(~np.isnan(readings.snr[0].numpy()))[1]
    omega = dense.covariance(*FADING)
    columns = [(receiver == 4).astype(float), np.eye(len(dense.y))[-3]]
    for column, offsets, k in zip(columns, (found.sensor, found.reading), (4, len(dense.y) - 3), strict=True):
        H = np.column_stack([dense.H, column])
        covariance = np.linalg.inv(H.T @ np.linalg.solve(omega, H))
        offset = (covariance @ H.T @ np.linalg.solve(omega, dense.y))[2]
        z = offset / np.sqrt(covariance[2, 2])
        assert float(offsets.mean[k]) == pytest.approx(offset, abs=1e-9)
        assert float(offsets.standardized[k]) == pytest.approx(z, abs=1e-9)
        assert float(offsets.p[k]) == pytest.approx(2.0 * stats.norm.sf(abs(z)), rel=1e-6)


def test_path_loss_residuals_are_those_of_a_line_without_the_reading():
    readings = simulate()
    x = torch.log10(readings.distance).flatten().numpy()
    y = (readings.snr[0] + TRUTH.budget.known_loss_dB(readings.distance)).flatten().numpy()
    line = stats.linregress(x[1:], y[1:])
    expected = y[0] - line.intercept - line.slope * x[0]
    assert float(diagnose(readings, TRUTH).path_loss[0]) == pytest.approx(expected, abs=1e-9)


def test_the_true_model_leaves_standard_normal_numbers():
    found = [diagnose(simulate(seed), TRUTH) for seed in range(20)]
    whitened = torch.cat([each.whitened for each in found])
    assert len(whitened) == 20 * (MESSAGES * SENSORS - 2)
    assert stats.kstest(whitened.numpy(), "norm").pvalue > 0.01
    sensors = torch.cat([each.sensor.standardized for each in found])
    assert float(sensors.square().mean()) == pytest.approx(1.0, abs=0.2)
    assert float(torch.tensor([each.rms for each in found]).mean()) == pytest.approx(1.0, abs=0.05)


def test_moments_against_scipy():
    found = diagnose(simulate(), TRUTH)
    whitened = found.whitened.numpy()
    assert found.skewness == pytest.approx(stats.skew(whitened))
    assert found.excess_kurtosis == pytest.approx(stats.kurtosis(whitened))
    assert found.normality_p == pytest.approx(stats.jarque_bera(whitened).pvalue)


def test_an_outlier_and_a_lying_sensor_are_named():
    """Whatever the fading may be."""
    readings = simulate()
    snr = readings.snr.clone()
    snr[0, 3, 5] += 15.0
    found = whatever_the_fading(replace(readings, snr=snr))
    assert found.reading.worst == 3 * SENSORS + 5
    assert float(found.reading.p[found.reading.worst]) < 1e-5
    assert found.accused(0.01) == []
    snr = readings.snr.clone()
    snr[0, :, 9] -= 12.0
    found = whatever_the_fading(replace(readings, snr=snr))
    assert found.accused(0.01) == [found.sensor.worst] == [9]
    assert float(found.sensor.mean[9]) == pytest.approx(-12.0, abs=4.0)


def whatever_the_fading(readings: Readings) -> Diagnostics:
    return diagnose_with(readings, FadingPosterior.coarse(Links.of(readings, TRUTH.budget)))


def standing_stations(seed: int, pings: int = 12, stations: int = 8) -> Readings:
    """Anywhere between 20 and 340 m from a vehicle that does not move."""
    generator = torch.Generator().manual_seed(seed)
    kind = {"generator": generator, "dtype": torch.float64}
    radius, angle = 20.0 + 320.0 * torch.rand(stations, **kind), 2.0 * torch.pi * torch.rand(stations, **kind)
    places = torch.stack([radius * angle.cos(), radius * angle.sin(), torch.full_like(radius, -5.0)], -1)
    vehicle = torch.tensor([[0.0, 0.0, -5.0]], dtype=torch.float64)
    white, multipath = torch.randn(1, 1, stations, **kind), torch.randn(1, pings, stations, **kind)
    link = TRUTH.mean_snr_dB(radius) + exact_shadowing(vehicle, places, TRUTH.zeta_dB, TRUTH.varphi_m, white)
    return Readings(vehicle.expand(pings, 3), places, link + TRUTH.rho_dB * multipath)


def test_healthy_standing_stations_are_not_accused():
    """Alarms in 150 logs at a rate of 10 %, within 99.9 % of what chance allows; p-values are uniform."""
    logs = [whatever_the_fading(standing_stations(seed)) for seed in range(150)]
    alarms = sum(bool(log.accused(0.1)) for log in logs)
    low, high = stats.binom.ppf([0.0005, 0.9995], 150, 0.1)
    assert low <= alarms <= high
    assert sum(bool(log.accused(0.01)) for log in logs) <= stats.binom.ppf(0.999, 150, 0.01)
    # One probability per log, because those of one log depend on each other.
    assert stats.kstest([float(log.sensor.p[0]) for log in logs], "uniform").pvalue > 0.001


def test_a_broken_standing_station_is_accused():
    """60 dB off: more than any shadowing of the others."""
    readings = standing_stations(0)
    readings.snr[..., 3] -= 60.0
    assert whatever_the_fading(readings).accused(0.01) == [3]


def test_one_sensor_has_no_others():
    readings = simulate()
    alone = replace(readings, receivers=readings.receivers[:1], snr=readings.snr[..., :1])
    found = diagnose(alone, TRUTH)
    assert found.sensor.worst is None
    assert found.accused(0.01) == []
    assert not bool(found.residual.isnan().any())


def test_semivariogram_of_the_truth():
    parts = [diagnose(simulate(seed), TRUTH).semivariogram for seed in range(20)]
    empirical = torch.stack([part.empirical[2:12] for part in parts]).mean(0)
    fitted = torch.stack([part.fitted[2:12] for part in parts]).mean(0)
    assert empirical.tolist() == pytest.approx(fitted.tolist(), rel=0.25)


@pytest.mark.parametrize("freedom", [1, 2, 5, 30, 1498])
def test_student_t_against_scipy(freedom: int):
    assert student_t(0.95, freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-6)
