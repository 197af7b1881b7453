"""The estimation experiments, with tiny settings: what they judge by, against NumPy and SciPy, and what they write."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from scipy import stats

from uwirl import build
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.snr.estimators import oracle
from uwirl.study import style
from uwirl.world.acoustics import Channel
from uwirl.world.truth import truth_of

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
KINDS = ("rmse_over_bound", "coverage_percent", "told_percent")


@pytest.fixture(scope="module")
def estimators():
    return runpy.run_path(str(EXPERIMENTS / "estimators.py"))


@pytest.fixture(scope="module")
def planning():
    return runpy.run_path(str(EXPERIMENTS / "planning_on_map.py"))


@pytest.fixture
def channel(make_config) -> Channel:
    return build.make_channel(make_config("channel=acoustic_24khz").channel)


@pytest.fixture
def scenario(make_config):
    return build.make_scenario(make_config("experiment=fig5_free"))


def test_every_row_of_the_table(estimators):
    settings = OmegaConf.load(EXPERIMENTS / "conf" / "estimators.yaml")
    settings.channels, settings.sizes = ["acoustic_24khz"], [[16, 1], [16, 2]]
    settings.data_sets, settings.layouts = 20, 2
    metrics = estimators["study"](settings)
    rows = [f"acoustic_24khz_16_{S}_{name}" for S in (1, 2) for name in settings.estimators]
    assert metrics.keys() == {f"{row}_{kind}_{name}" for row in rows for kind in KINDS for name in NAMES}
    for row in rows:
        assert metrics[f"{row}_told_percent_K_dB"] == metrics[f"{row}_told_percent_n"] == 100.0
        # Unbiased estimates reach the bound at best, and 20 of them fall this low once in 10,000.
        assert metrics[f"{row}_rmse_over_bound_K_dB"] > np.sqrt(stats.chi2.ppf(1e-4, 20) / 20.0)


def test_simulated_data_sets_share_their_places(estimators, scenario, channel: Channel):
    readings = estimators["simulate"](scenario, channel, (5, 3), 1, 4)
    assert readings.snr.shape == (4, 3, 5)
    assert torch.equal(readings.transmitters[0], scenario.start[0, :3])
    places = torch.cat([readings.transmitters, readings.receivers])
    assert len(places.unique(dim=0)) == 8
    assert not bool((readings.snr[1:] == readings.snr[0]).any())
    still = estimators["simulate"](scenario, replace(channel, zeta_dB=0.0, rho_dB=0.0), (5, 3), 1, 4)
    lengths = np.linalg.norm(still.transmitters.numpy()[:, None] - still.receivers.numpy(), axis=-1)
    mean = -60.0 - 20.0 * np.log10(lengths) - channel.budget.absorption_dB_per_km * lengths / 1000.0 + 104.0
    np.testing.assert_allclose(still.snr, np.broadcast_to(mean, (4, 3, 5)), rtol=0.0, atol=1e-10)


def bound_by_hand(transmitter: np.ndarray, sensors: np.ndarray, zeta2: float, varphi: float, rho2: float) -> np.ndarray:
    """Square roots of the diagonal of the inverse Fisher information of one message, [5]."""
    H = np.stack([np.ones(len(sensors)), -10.0 * np.log10(np.linalg.norm(sensors - transmitter, axis=-1))], -1)
    apart = np.linalg.norm(sensors[:, None] - sensors, axis=-1)
    shadowing = zeta2 * np.exp(-apart / varphi)
    precision = np.linalg.inv(shadowing + rho2 * np.eye(len(sensors)))
    by_log = [precision @ D for D in (shadowing, shadowing * apart / varphi, rho2 * np.eye(len(sensors)))]
    fisher = np.array([[0.5 * np.trace(A @ B) for A in by_log] for B in by_log])
    return np.sqrt([*np.diag(np.linalg.inv(H.T @ precision @ H)), *np.diag(np.linalg.inv(fisher))])


def test_judged_by_hand(estimators, scenario, channel: Channel):
    """Three estimates: just within each interval, just outside, and the truth; the second tells no varphi."""
    readings = estimators["simulate"](scenario, channel, (12, 1), 0, 3)
    truth = np.array([-60.0, 2.0, 9.0, 15.0, 1.0])
    std = np.array([2.0, 0.3, 0.4, 0.5, 0.2])
    width = np.array([stats.t.ppf(0.975, 10)] * 2 + [stats.norm.ppf(0.975)] * 3) * std
    value = np.stack([truth, truth, truth])
    for row, share in ((0, 0.999), (1, 1.001)):
        value[row, :2] += share * width[:2]
        value[row, 2:] *= np.exp(-share * width[2:])
    estimate = oracle(readings, channel.budget, channel)
    told = torch.ones(3, 5, dtype=torch.bool)
    told[1, 3] = False
    covariance = torch.from_numpy(np.diag(std**2)).expand(3, 5, 5)
    estimate = replace(estimate, value=torch.from_numpy(value), covariance=covariance, identifiable=told)
    assert isinstance(estimate, ChannelEstimate)
    errors = estimators["judge"](readings, channel, estimate)
    bound = bound_by_hand(readings.transmitters[0].numpy(), readings.receivers.numpy(), 9.0, 15.0, 1.0)
    relative = (value - truth) / bound / [1.0, 1.0, 9.0, 15.0, 1.0]
    np.testing.assert_allclose(errors.relative, relative, rtol=1e-9, atol=1e-12)
    assert errors.covered.tolist() == [[True] * 5, [False] * 5, [True] * 5]
    figures = estimators["row"](errors)
    for k, name in enumerate(NAMES):
        assert figures[f"rmse_over_bound_{name}"] == pytest.approx(np.sqrt(np.mean(relative[:, k] ** 2)), rel=1e-9)
        # Of the data sets that tell it.
        assert figures[f"coverage_percent_{name}"] == pytest.approx(100.0 if k == 3 else 200.0 / 3.0)
        assert figures[f"told_percent_{name}"] == pytest.approx(200.0 / 3.0 if k == 3 else 100.0)


def test_nothing_told_covers_nothing(estimators):
    errors = estimators["Errors"](torch.ones(4, 5), torch.ones(4, 5).bool(), torch.zeros(4, 5).bool())
    figures = estimators["row"](errors)
    assert figures["coverage_percent_varphi_m"] is None
    assert "-" in estimators["line"]("title", figures, 1.0)


def test_gains_and_their_intervals(planning):
    """SciPy's t interval of the mean of gains in percent over the midpoint."""
    capacity = np.random.default_rng(0).uniform(15.0, 30.0, (9, 3))
    metrics = planning["statistics"](torch.from_numpy(capacity))
    for k, name in ((1, "map"), (2, "best")):
        gain = 100.0 * (capacity[:, k] / capacity[:, 0] - 1.0)
        low, high = stats.t.interval(0.95, 8, loc=gain.mean(), scale=stats.sem(gain))
        assert metrics[f"gain_{name}_percent"] == pytest.approx(0.5 * (low + high), rel=1e-9)
        assert metrics[f"gain_{name}_percent_half_interval_95"] == pytest.approx(0.5 * (high - low), rel=1e-6)
        assert metrics[f"worse_{name}_percent"] == pytest.approx(100.0 * np.mean(capacity[:, k] < capacity[:, 0]))
    means = [metrics[f"capacity_{name}_kbps"] for name in ("midpoint", "map", "best")]
    assert means == pytest.approx(capacity.mean(0), rel=1e-12)


def test_two_seeds_on_their_maps(planning, make_relay, tmp_path: Path):
    """True capacities at the three places, maps that hold them, and the figure."""
    overrides = ["experiment=fig5_free", "channel=acoustic_24khz", "scenario.sensors=64"]
    seeds = [planning["one_seed"](overrides, seed) for seed in range(2)]
    for seed, (capacity, example) in enumerate(seeds):
        truth = truth_of(make_relay(*overrides, f"seed={seed}"))
        assert example.places[0].tolist() == [0.0, 0.0, -8.0]
        for carried, place in zip(capacity, example.places, strict=True):
            links = truth.link_capacities_kbps(place[None, None], shadowed=True)
            assert carried == pytest.approx(float(links.amin()), rel=1e-12)
        assert capacity[2] >= max(capacity[:2])
        x, y = example.axes
        assert example.truth.shape == example.expected.shape == (len(x), len(y))
        corner = torch.stack([x[3], y[-2], example.places[0, 2]])
        links = truth.link_capacities_kbps(corner[None, None], shadowed=True)
        assert float(example.truth[3, -2]) == pytest.approx(float(links.amin()), rel=1e-9)
    figure = planning["draw"](torch.tensor([capacity for capacity, _ in seeds]), seeds[0][1])
    assert [axes.get_title(loc="left")[:3] for axes in figure.axes[:3]] == ["(a)", "(b)", "(c)"]
    style.save(figure, tmp_path / "figures" / "planning_on_map.png")
    assert (tmp_path / "figures" / "planning_on_map.png").stat().st_size > 50_000
