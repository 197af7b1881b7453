"""Navigation: noise of the stated spread, a position that drifts away, and a pure function of seed, world and step."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import pytest
import torch
from scipy import stats
from torch import Tensor

from uwirl.world.navigation import Navigation
from uwirl.world.random import RandomStreams
from uwirl.world.relay import Relay

WORLDS = 20_000
NOISY = Navigation(position_m=0.4, yaw_rad=0.03, velocity_mps=0.02, yaw_rate_rad_s=0.007)
STD = [0.4, 0.4, 0.4, 0.03, 0.02, 0.02, 0.02, 0.007]
# Steps of 0.05 s.
DT = 0.05


def error(navigation: Navigation, step: int, streams: RandomStreams | None = None, vehicles: int = 2) -> Tensor:
    streams = streams or RandomStreams.worlds(3, WORLDS)
    steps = torch.full_like(streams.world, step)
    return navigation.error(streams, steps, DT, vehicles)


@pytest.fixture(scope="module")
def noise() -> Tensor:
    """Of both vehicles at step 7, [worlds, 16]."""
    return error(NOISY, 7).flatten(1)


def test_noise_has_no_mean(noise: Tensor):
    # Sixteen means, none beyond 4.5 standard errors.
    assert bool((noise.mean(0).abs() < 4.5 * torch.tensor(STD * 2) / math.sqrt(WORLDS)).all())


def test_noise_has_the_stated_spread(noise: Tensor):
    low, high = (stats.chi2.ppf(p, WORLDS) for p in (1e-5, 1.0 - 1e-5))
    power = noise.square().sum(0) / torch.tensor(STD * 2).double().square()
    assert bool(((power > low) & (power < high)).all())


def test_noise_is_gaussian(noise: Tensor):
    scaled = (noise / torch.tensor(STD * 2)).flatten()
    assert stats.kstest(scaled.numpy(), "norm").pvalue > 0.01


def test_components_vehicles_worlds_and_steps_are_independent(noise: Tensor):
    columns = torch.cat([noise[1:], noise[:-1], error(NOISY, 8).flatten(1)[1:]], 1)
    correlation = torch.corrcoef(columns.T) - torch.eye(48)
    # 1,128 coefficients of standard deviation 1 / sqrt(20,000): none beyond 5.
    assert float(correlation.abs().max()) < 5.0 / math.sqrt(WORLDS)


def test_drift_grows_linearly():
    drifting = Navigation(drift_mps=0.05)
    first = error(drifting, 100)
    torch.testing.assert_close(error(drifting, 300), 3.0 * first, rtol=1e-12, atol=0.0)
    assert not bool(error(drifting, 0).any())
    # After 5 s each horizontal component is off by 0.25 m on average; depth, yaw and velocity are not.
    horizontal = first[..., :2].flatten(1)
    low, high = (stats.chi2.ppf(p, WORLDS) for p in (1e-5, 1.0 - 1e-5))
    power = horizontal.square().sum(0) / 0.25**2
    assert bool(((power > low) & (power < high)).all())
    assert bool((horizontal.mean(0).abs() < 4.5 * 0.25 / math.sqrt(WORLDS)).all())
    assert float((torch.corrcoef(horizontal.T) - torch.eye(4)).abs().max()) < 4.5 / math.sqrt(WORLDS)
    assert not bool(first[..., 2:].any())


def test_drift_adds_to_noise():
    both = replace(NOISY, drift_mps=0.05)
    expected = error(NOISY, 60) + error(Navigation(drift_mps=0.05), 60)
    torch.testing.assert_close(error(both, 60), expected, rtol=0.0, atol=1e-15)


def test_a_batch_equals_its_singles():
    both = replace(NOISY, drift_mps=0.05)
    together = error(both, 5)
    for world in (0, 4_321, WORLDS - 1):
        alone = RandomStreams(torch.tensor([3]), torch.tensor([world]))
        assert torch.equal(error(both, 5, alone), together[world, None])
    assert torch.equal(error(both, 5), together)
    assert not bool((error(both, 5, RandomStreams.worlds(4, WORLDS)) == together).any())


def test_worlds_at_different_steps_equal_singles():
    both, streams = replace(NOISY, drift_mps=0.05), RandomStreams.worlds(3, 4)
    step = torch.tensor([0, 9, 2, 1_000])
    together = both.error(streams, step, DT, 1)
    for k in range(4):
        assert torch.equal(together[k], error(both, int(step[k]), streams, vehicles=1)[k])


def test_off_by_default_and_then_exact(env: Relay):
    state, observation = env.reset()
    assert env.scenario.navigation == Navigation()
    assert Navigation().is_exact
    assert torch.equal(observation.eta, state.vehicles.eta)
    assert torch.equal(observation.nu, state.vehicles.nu)


@pytest.mark.parametrize("name", [field.name for field in fields(Navigation)])
def test_any_error_counts(env: Relay, name: str):
    """Each for its own components, in what the vehicle perceives."""
    navigation = Navigation(**{name: 0.1})
    assert not navigation.is_exact
    off = env.on(replace(env.scenario, navigation=navigation), env.streams)
    state = env.start()._replace(step=torch.full((5,), 20))
    observation = off.observe(state)
    wrong = torch.cat([observation.eta, observation.nu], -1) != state.components.movedim(0, -1)
    expected = {
        "position_m": [True, True, True, False, False, False, False, False],
        "yaw_rad": [False, False, False, True, False, False, False, False],
        "velocity_mps": [False, False, False, False, True, True, True, False],
        "yaw_rate_rad_s": [False, False, False, False, False, False, False, True],
        "drift_mps": [True, True, False, False, False, False, False, False],
    }[name]
    assert wrong.tolist() == [[expected] * 2] * 5
    torch.testing.assert_close(observation.eta, state.vehicles.eta + error_of(off, 20)[..., :4], rtol=0.0, atol=1e-12)


def error_of(env: Relay, step: int) -> Tensor:
    return error(env.scenario.navigation, step, env.streams)


def test_the_world_does_not_feel_what_the_vehicle_believes(env: Relay):
    """The same tau moves it alike, however wrong its navigation."""
    off = env.on(replace(env.scenario, navigation=NOISY), env.streams)
    tau = torch.ones(5, 2, 4, dtype=torch.float64)
    (exact, _), (noisy, perceived) = env.step(env.start(), tau), off.step(off.start(), tau)
    assert torch.equal(exact.components, noisy.components)
    assert not bool((perceived.eta == exact.vehicles.eta).any())
