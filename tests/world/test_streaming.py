"""Readings in flight: when they come, who hears whom, and their distribution over worlds."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from scipy import stats
from torch import Tensor

from uwirl.world.messages import Messages
from uwirl.world.navigation import Navigation
from uwirl.world.random import RandomStreams
from uwirl.world.readings import take_readings
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of

ACOUSTIC = "channel=acoustic_24khz"
NODES = [[-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]]
START = [[-12.0, -9.0, -7.0], [10.0, 11.0, -6.0]]
# Of shadowing and of multipath, dB, and worlds to judge them by.
ZETA, RHO, WORLDS = 3.0, 1.0, 800


@pytest.fixture
def env(make_pair) -> Relay:
    return make_pair(ACOUSTIC, streaming=True)


def at(env: Relay, step: int) -> Messages:
    """What is received at the start's poses after so many steps."""
    state = env.start()
    return env.observe(state._replace(step=state.step + step)).messages


def lengths(env: Relay) -> Tensor:
    """Between each vehicle's three transmitters and the sensors, [2, 3, N], m."""
    sensors = env.scenario.sensors.tolist()
    rows = [[[math.dist(node, sensor) for sensor in sensors] for node in (own, *NODES)] for own in START]
    return torch.tensor(rows, dtype=torch.float64)


def test_a_message_at_the_start_is_what_is_read_there(env: Relay):
    """By the sensors that answered, in every world and from every vehicle."""
    env = env.on(replace(env.scenario, hearing_range=45.0), env.streams)
    snr = at(env, 0).snr
    for world in range(env.worlds):
        for vehicle in range(2):
            readings = take_readings(env, vehicle, world)
            answered = ~snr[world, vehicle, 0].isnan()
            assert 0 < int(answered.sum()) < len(answered)
            assert torch.equal(readings.receivers, env.scenario.sensors[answered])
            streamed = snr[world, vehicle][:, answered]
            torch.testing.assert_close(streamed, readings.snr[0], rtol=0.0, atol=1e-12, equal_nan=True)


@pytest.mark.parametrize("period", [0.5, 0.05, 0.35])
def test_messages_come_every_period(make_pair, period: float):
    env = make_pair(ACOUSTIC, streaming=True, message_period=period)
    every = round(period / 0.05)
    for step in range(22):
        assert at(env, step).snr.shape == (5, 2, 3, 16 if step % every == 0 else 0)


def test_without_streaming_nothing_is_read(make_pair):
    assert {at(make_pair(ACOUSTIC), step).snr.shape for step in (0, 1, 10)} == {(5, 2, 3, 0)}


def test_who_hears_whom(env: Relay):
    """A sensor answers whom it hears, and then tells what it hears of source and destination."""
    deaf = env.on(replace(env.scenario, hearing_range=45.0), env.streams)
    heard = lengths(env) <= 45.0
    expected = heard & heard[:, :1]
    assert 0 < int(expected.sum()) < int(heard.sum()) < heard.numel()
    for step in (0, 30):
        partly, wholly = at(deaf, step).snr, at(env, step).snr
        assert torch.equal(~partly.isnan(), expected.expand(5, 2, 3, 16))
        assert not bool(wholly.isnan().any())
        # What is heard does not depend on who else hears it.
        assert torch.equal(partly[~partly.isnan()], wholly[~partly.isnan()])


@pytest.fixture(scope="module")
def faded(make_relay) -> Tensor:
    """Fading of 24 links in the first and the fourth message of each of many worlds, [2, worlds, 24], dB."""
    start = "scenario.start=[[-12,-9,-7,0.5],[10,11,-6,-1]]"
    env = make_relay(ACOUSTIC, start, "scenario.sensors=4", streams=RandomStreams.worlds(5, WORLDS))
    env = env.on(replace(env.scenario, streaming=True), env.streams)
    l = lengths(env)
    mean = -60.0 - 20.0 * torch.log10(l) - truth_of(env).channel.budget.absorption_dB_per_km * l / 1000.0 + 104.0
    return torch.stack([(at(env, step).snr - mean).flatten(1) for step in (0, 30)])


def test_readings_are_mean_plus_shadowing_plus_multipath(faded: Tensor):
    """Over worlds each link's reading has the mean SNR (6) and the variance zeta^2 + rho^2, and is nearly Gaussian."""
    variance = ZETA**2 + RHO**2
    # 48 means and variances: none beyond 4.5 standard errors.
    assert bool((faded.mean(1).abs() < 4.5 * math.sqrt(variance / WORLDS)).all())
    power = faded.square().mean(1)
    assert bool(((power / variance - 1.0).abs() < 4.5 * math.sqrt(2.0 / WORLDS)).all())
    first_link = faded[0, :, 0] / math.sqrt(variance)
    assert stats.kstest(first_link.numpy(), "norm").pvalue > 0.01


def test_a_links_shadowing_stays_and_its_multipath_does_not(faded: Tensor):
    """Between two messages over one link: the covariance is zeta^2, the difference has the variance 2 rho^2."""
    difference = faded[1] - faded[0]
    power = difference.square().mean(0) / (2.0 * RHO**2)
    assert bool(((power - 1.0).abs() < 4.5 * math.sqrt(2.0 / WORLDS)).all())
    covariance = (faded[0] * faded[1]).mean(0)
    error = math.sqrt(((ZETA**2 + RHO**2) ** 2 + ZETA**4) / WORLDS)
    assert bool(((covariance - ZETA**2).abs() < 4.5 * error).all())
    # Multipath of different links and vehicles is independent; both vehicles' messages make the source sound anew.
    correlation = torch.corrcoef(difference.T) - torch.eye(24)
    assert float(correlation.abs().max()) < 4.5 / math.sqrt(WORLDS)


def test_readings_are_of_where_the_vehicle_is(env: Relay):
    """Not of where it takes itself to be."""
    lost = env.on(replace(env.scenario, navigation=Navigation(position_m=5.0)), env.streams)
    assert torch.equal(at(lost, 0).snr, at(env, 0).snr)
    assert not torch.equal(at(lost, 0).eta, at(env, 0).eta)


def test_a_world_reads_the_same_in_any_batch(env: Relay):
    together = at(env, 20).snr
    for world in range(5):
        alone = at(env.select(torch.tensor([world])), 20).snr
        torch.testing.assert_close(alone, together[world, None], rtol=0.0, atol=1e-12)
    assert bool((together[0] != together[1]).all())
