"""Leave-one-out residuals against kriging without the reading, and what becomes of logs that are wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from scipy import stats

from uwirl.snr.diagnostics import diagnose
from uwirl.snr.intervals import student_t
from uwirl.snr.kriging import Kriging
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.fading import exact_shadowing
from uwirl.world.readings import Readings

TRUTH = Channel(LinkBudget(-104.0, 6.0, "thorp", 24.0), -60.0, 2.0, zeta_dB=3.0, varphi_m=15.0, rho_dB=1.0)
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


def test_a_sensor_is_judged_by_the_others():
    readings = simulate()
    found = diagnose(readings, TRUTH)
    without = readings.snr.clone()
    without[0, :, 4] = math.nan
    mean, _ = universal(replace(readings, snr=without)).predict(readings.transmitters, readings.receivers[4])
    assert float(found.sensor_mean[4]) == pytest.approx(float((readings.snr[0, :, 4] - mean).mean()), abs=1e-9)


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
    sensors = torch.cat([each.sensor_standardized for each in found])
    assert float(sensors.square().mean()) == pytest.approx(1.0, abs=0.2)
    assert float(torch.tensor([each.rms for each in found]).mean()) == pytest.approx(1.0, abs=0.05)


def test_moments_against_scipy():
    found = diagnose(simulate(), TRUTH)
    whitened = found.whitened.numpy()
    assert found.skewness == pytest.approx(stats.skew(whitened))
    assert found.excess_kurtosis == pytest.approx(stats.kurtosis(whitened))
    assert found.normality_p == pytest.approx(stats.jarque_bera(whitened).pvalue)


def test_an_outlier_and_a_lying_sensor_are_named():
    readings = simulate()
    snr = readings.snr.clone()
    snr[0, 3, 5] += 15.0
    found = diagnose(replace(readings, snr=snr), TRUTH)
    assert found.worst == 3 * SENSORS + 5
    assert float(found.standardized[found.worst]) > 6.0
    snr = readings.snr.clone()
    snr[0, :, 9] -= 12.0
    found = diagnose(replace(readings, snr=snr), TRUTH)
    assert found.worst_sensor == 9
    assert float(found.sensor_mean[9]) == pytest.approx(-12.0, abs=5.0)


def test_one_sensor_has_no_others():
    readings = simulate()
    alone = replace(readings, receivers=readings.receivers[:1], snr=readings.snr[..., :1])
    found = diagnose(alone, TRUTH)
    assert found.worst_sensor is None
    assert not bool(found.residual.isnan().any())


def test_semivariogram_of_the_truth():
    parts = [diagnose(simulate(seed), TRUTH).semivariogram for seed in range(20)]
    empirical = torch.stack([part.empirical[2:12] for part in parts]).mean(0)
    fitted = torch.stack([part.fitted[2:12] for part in parts]).mean(0)
    assert empirical.tolist() == pytest.approx(fitted.tolist(), rel=0.25)


@pytest.mark.parametrize("freedom", [1, 2, 5, 30, 1498])
def test_student_t_against_scipy(freedom: int):
    assert student_t(0.95, freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-6)
