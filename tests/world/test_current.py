"""Ocean current: moments against the Gauss-Markov covariance, independence of the batch, and water at rest."""

from __future__ import annotations

import pytest
import torch

from uwirl.world.current import Current
from uwirl.world.random import RandomStreams

WORLDS = 20_000
MEAN = torch.tensor([0.3, -0.1, 0.02], dtype=torch.float64)
CURRENT = Current(MEAN, std=0.2, time_constant=50.0)


@pytest.fixture(scope="module")
def deviations() -> dict[float, torch.Tensor]:
    """Horizontal deviation from the mean, [worlds, 2], at some times."""
    field = CURRENT.realise(RandomStreams.worlds(1, WORLDS))
    return {time: (field(time) - MEAN)[:, :2] for time in (0.0, 1.0, 10.0, 50.0, 100.0, 1000.0)}


def standard_error(product: torch.Tensor) -> float:
    return float(product.std()) / product.numel() ** 0.5


def test_mean(deviations):
    for deviation in deviations.values():
        assert abs(float(deviation.mean())) < 4.0 * standard_error(deviation)


@pytest.mark.parametrize(("first", "second"), [(0.0, 0.0), (0.0, 1.0), (0.0, 10.0), (50.0, 100.0), (100.0, 0.0)])
def test_covariance_is_gauss_markov(deviations, first, second):
    product = deviations[first] * deviations[second]
    expected = 0.2**2 * torch.exp(torch.tensor(-abs(first - second) / 50.0))
    assert abs(float(product.mean() - expected)) < 4.0 * standard_error(product)


def test_what_is_far_apart_is_uncorrelated(deviations):
    product = deviations[0.0] * deviations[1000.0]
    assert abs(float(product.mean())) < 4.0 * standard_error(product)


def test_components_and_worlds_are_uncorrelated(deviations):
    x, y = deviations[10.0].T
    for product in (x * y, x[1:] * x[:-1]):
        assert abs(float(product.mean())) < 4.0 * standard_error(product)


def test_distribution_is_nearly_normal(deviations):
    """The excess kurtosis of a sum of K cosines is -3 / (2 K)."""
    x = deviations[0.0].flatten() / 0.2
    assert float(x.pow(4).mean()) == pytest.approx(3.0 - 1.5 / 64, abs=4.0 * standard_error(x.pow(4)))


def test_one_world_over_time_has_the_spread_of_many():
    series = CURRENT.realise(RandomStreams.worlds(3, 4))(torch.arange(0.0, 50_000.0, 10.0)[:, None])
    assert series.shape == (5000, 4, 3)
    torch.testing.assert_close(series[..., :2].std(0), torch.full((4, 2), 0.2).double(), rtol=0.15, atol=0.0)


def test_vertical_component_is_the_mean():
    assert torch.equal(CURRENT.realise(RandomStreams.worlds(1, 5))(12.0)[:, 2], MEAN[2].expand(5))


def test_world_has_the_same_current_in_any_batch():
    many = CURRENT.realise(RandomStreams.worlds(7, 50))
    alone = CURRENT.realise(RandomStreams(torch.tensor([7]), torch.tensor([37])))
    for time in (0.0, 33.3):
        assert torch.equal(many(time)[37:38], alone(time))
    assert not torch.equal(many(33.3), CURRENT.realise(RandomStreams.worlds(8, 50))(33.3))


def test_each_world_at_its_own_time():
    field = CURRENT.realise(RandomStreams.worlds(7, 3))
    time = torch.tensor([0.0, 5.0, 70.0])
    together = field(time)
    for world in range(3):
        torch.testing.assert_close(together[world], field(float(time[world]))[world])


def test_worlds_may_have_other_means():
    mean = torch.arange(6.0).view(2, 3)
    assert torch.equal(Current(mean, 0.0, 50.0).realise(RandomStreams.worlds(0, 2))(9.0), mean)


def test_without_spread_it_is_exactly_the_mean():
    steady = Current(MEAN, std=0.0, time_constant=50.0)
    field = steady.realise(RandomStreams.worlds(0, 4))
    assert torch.equal(field(17.0), MEAN.expand(4, 3))
    assert torch.equal(field(torch.zeros(7, 1)), MEAN.expand(7, 4, 3))
    assert not steady.is_still


def test_still_water():
    still = Current.still()
    assert still.is_still
    assert torch.equal(still.realise(RandomStreams.worlds(0, 4))(17.0), torch.zeros(4, 3, dtype=torch.float64))
    assert not CURRENT.is_still


def test_precision_is_that_of_the_mean():
    narrow = Current(MEAN.float(), 0.2, 50.0).realise(RandomStreams.worlds(1, 6))(1e4)
    assert narrow.dtype == torch.float32
    torch.testing.assert_close(narrow.double(), CURRENT.realise(RandomStreams.worlds(1, 6))(1e4), rtol=0, atol=1e-6)
