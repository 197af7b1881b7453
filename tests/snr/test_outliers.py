"""Outliers and a lying sensor are found, clean readings are kept, estimates survive pollution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from dense import simulate
from scipy import stats

from uwirl import build
from uwirl.snr.estimators import maximum_likelihood
from uwirl.snr.outliers import reject_outliers, repeated_median, unlike
from uwirl.world.acoustics import Channel
from uwirl.world.readings import Readings


def lost(before: Readings, after: Readings) -> torch.Tensor:
    """What was refused, bool [B, S, N]; the rest is as it was."""
    kept = ~after.snr.isnan()
    torch.testing.assert_close(after.snr[kept], before.snr[kept], rtol=0.0, atol=1e-12)
    return ~kept & ~before.snr.isnan()


def polluted(readings: Readings, share: float, seed: int = 0) -> Readings:
    """That share of each data set is 20 to 60 dB too loud."""
    generator = torch.Generator().manual_seed(seed)
    draws = torch.rand(readings.snr.shape, generator=generator).flatten(1)
    wrong = draws.argsort(1).argsort(1) < share * draws.shape[1]
    excess = 20.0 + 40.0 * torch.rand(readings.snr.shape, generator=generator).double()
    return replace(readings, snr=readings.snr + torch.where(wrong.view(readings.snr.shape), excess, 0.0))


def test_repeated_median_is_scipys():
    """But that of two middle values Torch takes the lower one."""
    x, noise = torch.randn(2, 200, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    y = 3.0 - 2.0 * x + noise
    slope, intercept = repeated_median(x, y)
    others = ~torch.eye(200, dtype=torch.bool)
    slopes = ((y[:, None] - y)[others] / (x[:, None] - x)[others]).view(200, 199).numpy()
    middle = np.sort(np.median(slopes, -1))[99:101]
    assert stats.siegelslopes(y.numpy(), x.numpy()).slope == pytest.approx(middle.mean(), rel=1e-12)
    assert float(slope) == pytest.approx(middle[0], rel=1e-12)
    assert float(intercept) == pytest.approx(float((y - slope * x).median()), rel=1e-12)


def test_repeated_median_endures_almost_half():
    x = torch.linspace(0.0, 1.0, 101, dtype=torch.float64)
    y = 5.0 + 2.0 * x
    y[torch.randperm(101, generator=torch.Generator().manual_seed(0))[:45]] += 100.0
    slope, intercept = repeated_median(x, y)
    assert float(slope) == pytest.approx(2.0, abs=1e-9)
    assert float(intercept) == pytest.approx(5.0, abs=1e-9)


def test_unlike_stands_apart():
    values = torch.tensor([0.1, -0.2, torch.nan, 0.0, 9.0, 0.2, -0.1, -9.0], dtype=torch.float64)
    assert unlike(values).tolist() == [False, False, False, False, True, False, False, True]


@pytest.mark.parametrize("messages", [1, 3])
def test_one_outlier_is_found(channel: Channel, messages: int):
    readings = simulate(channel, 24, messages, sets=20)
    loud = replace(readings, snr=readings.snr.clone())
    loud.snr[:, 0, 7] += 25.0
    found = lost(loud, reject_outliers(loud, channel.budget))
    assert bool(found[:, 0, 7].all())
    found[:, 0, 7] = False
    assert float(found.double().mean()) < 0.02


def test_a_sensor_that_lies_is_found(acoustic: Channel):
    """By 6 dB in all of 16 messages: no reading of it stands apart from multipath of 2 dB, but all do together."""
    noisy = replace(acoustic, zeta_dB=0.0, rho_dB=2.0)
    readings = simulate(noisy, 16, 16, sets=20)
    lying = replace(readings, snr=readings.snr.clone())
    lying.snr[:, :, 5] += 6.0
    found = lost(lying, reject_outliers(lying, noisy.budget))
    assert bool(found[:, :, 5].all())
    found[:, :, 5] = False
    assert float(found.double().mean()) < 0.002
    # One message tells nothing of it.
    once = Readings(lying.transmitters[:1], lying.receivers, lying.snr[:, :1])
    assert float(lost(once, reject_outliers(once, noisy.budget))[:, 0, 5].double().mean()) < 0.5


def test_clean_readings_are_kept(channel: Channel):
    for sensors, messages, rate in ((16, 1, 0.01), (16, 16, 0.01), (128, 1, 0.002)):
        still = replace(channel, zeta_dB=0.0)
        readings = simulate(still, sensors, messages, sets=50)
        assert float(lost(readings, reject_outliers(readings, still.budget)).double().mean()) < rate


def test_shadowed_readings_are_kept(acoustic: Channel):
    readings = simulate(acoustic, 64, 3, sets=20)
    assert float(lost(readings, reject_outliers(readings, acoustic.budget)).double().mean()) < 0.01


def test_noise_free_readings_are_kept(channel: Channel):
    clean = replace(channel, zeta_dB=0.0, rho_dB=0.0)
    readings = simulate(clean, 30, 3, sets=3)
    assert not bool(lost(readings, reject_outliers(readings, clean.budget)).any())


def test_what_was_not_heard_stays_so(channel: Channel):
    readings = simulate(channel, 20, 2, sets=3)
    readings.snr[:, 0, ::4] = torch.nan
    assert bool(reject_outliers(readings, channel.budget).snr[:, 0, ::4].isnan().all())


def test_forty_percent_of_gross_outliers(paper: Channel):
    readings = simulate(paper, 60, sets=20)
    wrong = polluted(readings, 0.4)
    cleaned = reject_outliers(wrong, paper.budget)
    gross = (wrong.snr - readings.snr) > 0.0
    assert bool(cleaned.snr[gross].isnan().all())
    assert float(lost(wrong, cleaned)[~gross].double().mean()) < 0.01
    # As good as from the readings that were right to begin with.
    right = maximum_likelihood(replace(readings, snr=torch.where(gross, torch.nan, readings.snr)), paper.budget)
    errors = right.covariance.diagonal(dim1=-2, dim2=-1).sqrt()[:, :2]
    survived = maximum_likelihood(cleaned, paper.budget)
    assert bool(((survived.theta - right.theta).abs() < errors).all())


@pytest.mark.parametrize("name", ["least_squares", "maximum_likelihood"])
def test_cleaned_estimates_are_better(acoustic: Channel, make_config, name: str):
    configs = [make_config(f"estimator={name}", f"estimator.robust={robust}") for robust in ("false", "true")]
    wrong = polluted(simulate(acoustic, 40, sets=20), 0.15)
    truth = torch.tensor([acoustic.K_dB, acoustic.n], dtype=torch.float64)
    estimates = [build.make_estimator(config.estimator)(wrong, acoustic.budget) for config in configs]
    raw, cleaned = ((estimate.theta - truth).square().mean(0).sqrt() for estimate in estimates)
    assert bool((cleaned < 0.5 * raw).all())
