"""Readings: who hears whom, path loss plus shadowing that stays plus multipath of power rho^2, and whose draws."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from scipy import stats
from torch import Tensor

from uwirl import build
from uwirl.world.random import RandomStreams
from uwirl.world.readings import Readings, take_readings
from uwirl.world.relay import Relay
from uwirl.world.scenario import spread_sensors
from uwirl.world.truth import truth_of
from uwirl.world.vehicle import Vehicle

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = [[29.5, 29.5, 0.0, 1.0], [10.0, 10.0, -6.0, 0.0]]
SENSORS = 1_000
READINGS = 3 * SENSORS


@pytest.fixture(params=["paper", "acoustic_24khz"])
def env(request: pytest.FixtureRequest, make_config) -> Relay:
    config = make_config(f"channel={request.param}")
    sensors = spread_sensors(SENSORS, 0, SOURCE, DESTINATION, torch.float64)
    source, destination, start = (torch.tensor(v, dtype=torch.float64) for v in (SOURCE, DESTINATION, START))
    scenario = replace(
        build.make_scenario(config), source=source, destination=destination, start=start, sensors=sensors
    )
    vehicle = Vehicle(**config.vehicle.values())
    return Relay(scenario, vehicle, build.make_channel(config.channel), RandomStreams.worlds(3, 4))


def faded(env: Relay, **channel: float) -> Relay:
    return Relay(env.scenario, env.vehicle, replace(truth_of(env).channel, **channel), env.streams)


def residual(env: Relay, readings: Readings) -> Tensor:
    """[3, N], dB."""
    return (readings.snr - truth_of(env).channel.mean_snr_dB(readings.distance))[0]


@pytest.mark.parametrize("vehicle", [0, 1])
def test_distances_by_hand(env: Relay, vehicle: int):
    """Of the vehicle, of the source and of the destination."""
    readings = take_readings(env, vehicle)
    assert readings.snr.shape == (1, 3, SENSORS)
    nodes, sensors = (START[vehicle][:3], SOURCE, DESTINATION), env.scenario.sensors.tolist()
    for row, node in zip(readings.distance.tolist(), nodes, strict=True):
        assert row == pytest.approx([math.dist(node, sensor) for sensor in sensors], rel=1e-13)


def test_multipath_is_gaussian_of_power_rho(env: Relay):
    still = faded(env, zeta_dB=0.0)
    multipath, rho = residual(still, take_readings(still)), truth_of(env).channel.rho_dB
    low, high = (stats.chi2.ppf(p, READINGS) for p in (1e-4, 1.0 - 1e-4))
    assert low < float(multipath.square().sum()) / rho**2 < high
    assert stats.kstest(multipath.flatten().numpy(), stats.norm(0.0, rho).cdf).pvalue > 0.01


def test_each_world_vehicle_and_message_has_its_own_multipath(env: Relay):
    still = faded(env, zeta_dB=0.0)
    worlds = [still.select(torch.tensor([k])) for k in range(4)]
    rows = [residual(world, take_readings(world, vehicle)) for world in worlds for vehicle in range(2)]
    correlation = torch.corrcoef(torch.cat(rows)) - torch.eye(24)
    # 276 coefficients of standard deviation 1 / sqrt(1,000): none beyond 4.5.
    assert float(correlation.abs().max()) < 4.5 / math.sqrt(SENSORS)


def test_shadowing_is_the_environments(env: Relay):
    """The first end is the transmitter, the second the sensor, and the same link keeps its shadowing."""
    silent = faded(env, rho_dB=0.0)
    first, second = (take_readings(silent, vehicle, world=2) for vehicle in (0, 1))
    # Both vehicles' sensors read the same of source and destination.
    assert torch.equal(first.snr[0, 1:], second.snr[0, 1:])
    for message, node in enumerate((START[0][:3], SOURCE, DESTINATION)):
        end = torch.tensor(node, dtype=torch.float64).expand(4, SENSORS, 3)
        field = truth_of(silent).shadowing(end, env.scenario.sensors.expand(4, SENSORS, 3))[2]
        torch.testing.assert_close(residual(silent, first)[message], field, rtol=0.0, atol=1e-9)
    assert float(residual(silent, first).std()) > 0.3 * truth_of(env).channel.zeta_dB


def test_world_reads_the_same_in_any_batch(env: Relay):
    alone = env.on(env.scenario, RandomStreams(torch.tensor([3]), torch.tensor([2])))
    together = take_readings(env, vehicle=1, world=2).snr
    torch.testing.assert_close(together, take_readings(alone, vehicle=1).snr, rtol=0.0, atol=1e-12)
    assert bool((together != take_readings(env, vehicle=1).snr).all())


def test_repeated_readings_are_the_same(env: Relay):
    assert torch.equal(take_readings(env).snr, take_readings(env).snr)


def test_no_fading_reads_the_mean(env: Relay):
    readings = take_readings(faded(env, zeta_dB=0.0, rho_dB=0.0))
    assert torch.equal(readings.snr[0], truth_of(env).channel.mean_snr_dB(readings.distance))


@pytest.mark.parametrize("vehicle", [0, 1])
def test_who_hears_whom(env: Relay, vehicle: int):
    """Sensors within range of the vehicle answer, with what they hear of source and destination."""
    deaf = env.on(replace(env.scenario, hearing_range=40.0), env.streams)
    readings, all_of_them = take_readings(deaf, vehicle), take_readings(env, vehicle)
    near = [math.dist(START[vehicle][:3], sensor) <= 40.0 for sensor in env.scenario.sensors.tolist()]
    assert 10 < sum(near) < SENSORS
    assert torch.equal(readings.receivers, env.scenario.sensors[near])
    assert not bool(readings.snr[0, 0].isnan().any())
    assert torch.equal(readings.snr.isnan(), (readings.distance > 40.0)[None])
    # What is heard does not depend on who else hears it.
    heard = ~readings.snr.isnan()
    torch.testing.assert_close(readings.snr[heard], all_of_them.snr[:, :, near][heard], rtol=0.0, atol=1e-12)


def test_worlds_may_start_elsewhere(env: Relay):
    start = env.scenario.start + torch.arange(4.0).double()[:, None, None]
    batch = env.on(replace(env.scenario, start=start), env.streams)
    assert torch.equal(take_readings(batch, 1, world=3).transmitters[0], start[3, 1, :3])


def test_selected_data_sets(env: Relay):
    readings = take_readings(env)
    many = replace(readings, snr=torch.cat([readings.snr, readings.snr + 1.0, readings.snr + 2.0]))
    assert torch.equal(many.select(slice(1, 3)).snr, many.snr[1:])
    assert torch.equal(many.select(torch.tensor([2, 0])).snr, many.snr[[2, 0]])
