"""Readings: distances, the mean channel plus Gaussian multipath of power rho^2, and whose noise is drawn."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest
import torch
from scipy import stats
from torch import Tensor

from uwirl import build
from uwirl.snr.measurements import Readings, take_readings
from uwirl.world.acoustics import Channel
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay
from uwirl.world.scenario import spread_sensors
from uwirl.world.vehicle import Vehicle

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = [[29.5, 29.5, 0.0, 1.0], [10.0, 10.0, -6.0, 0.0]]
SENSORS = 5_000


@pytest.fixture(params=["paper", "acoustic_24khz"])
def env(request: pytest.FixtureRequest, make_config) -> Relay:
    config = make_config(f"channel={request.param}")
    sensors = spread_sensors(SENSORS, 0, SOURCE, DESTINATION, torch.float64)
    source, destination, start = (torch.tensor(v, dtype=torch.float64) for v in (SOURCE, DESTINATION, START))
    scenario = replace(
        build.make_scenario(config), source=source, destination=destination, start=start, sensors=sensors
    )
    channel, vehicle = Channel(**asdict(config.channel)), Vehicle(**asdict(config.vehicle))
    return Relay(scenario, vehicle, channel, RandomStreams.worlds(3, 4))


def residual(env: Relay, readings: Readings) -> Tensor:
    return readings.snr - env.channel.mean_snr_dB(readings.distance)


@pytest.mark.parametrize("vehicle", [0, 1])
def test_distances_by_hand(env: Relay, vehicle: int):
    expected = [math.dist(START[vehicle][:3], sensor) for sensor in env.scenario.sensors.tolist()]
    assert take_readings(env, vehicle=vehicle).distance.tolist() == pytest.approx(expected, rel=1e-13)


def test_residual_is_gaussian_of_power_rho(env: Relay):
    multipath = residual(env, take_readings(env))
    rho = env.channel.rho_dB
    low, high = (stats.chi2.ppf(p, SENSORS) for p in (1e-4, 1.0 - 1e-4))
    assert low < float(multipath.square().sum()) / rho**2 < high
    assert stats.kstest(multipath.numpy(), stats.norm(0.0, rho).cdf).pvalue > 0.01


def test_each_world_and_vehicle_has_its_own_noise(env: Relay):
    rows = [residual(env, take_readings(env, world, vehicle)) for world in range(4) for vehicle in range(2)]
    correlation = torch.corrcoef(torch.stack(rows)) - torch.eye(8)
    # 28 coefficients of standard deviation 1 / sqrt(5,000): none beyond 4.
    assert float(correlation.abs().max()) < 4.0 / math.sqrt(SENSORS)


def test_world_reads_the_same_in_any_batch(env: Relay):
    alone = Relay(env.scenario, env.vehicle, env.channel, RandomStreams(torch.tensor([3]), torch.tensor([2])))
    assert torch.equal(take_readings(env, world=2).snr, take_readings(alone).snr)


def test_no_fading_reads_the_mean(env: Relay):
    still = Relay(env.scenario, env.vehicle, replace(env.channel, rho_dB=0.0), env.streams)
    readings = take_readings(still)
    assert torch.equal(readings.snr, env.channel.mean_snr_dB(readings.distance))
