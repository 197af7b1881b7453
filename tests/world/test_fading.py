"""Shadowing: covariances against the formula, nearly Gaussian, a pure function of seed, world and both ends."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from uwirl.world.fading import Shadowing, ShadowingField, exact_shadowing
from uwirl.world.random import RandomStreams, Stream

ZETA, VARPHI = 3.0, 15.0
# Three first and four second ends: pairs of links share both, either or none.
FIRST = torch.tensor([[0.0, 0.0, -8.0], [4.0, -3.0, -8.0], [30.0, 10.0, -1.0]], dtype=torch.float64)
SECOND = torch.tensor([[9.0, 9.0, -5.0], [9.0, 12.0, -5.0], [-20.0, 0.0, -2.0], [9.5, 9.0, -5.0]], dtype=torch.float64)
LINKS = len(FIRST) * len(SECOND)
ENDS = FIRST.repeat_interleave(len(SECOND), 0), SECOND.repeat(len(FIRST), 1)


def formula() -> Tensor:
    """zeta^2 exp(-(|p - p'| + |q - q'|) / varphi) of every pair of links, [12, 12], by Python's own distances."""
    links = list(zip(*(end.tolist() for end in ENDS), strict=True))
    rows = [[math.dist(p, s) + math.dist(q, t) for s, t in links] for p, q in links]
    return ZETA**2 * torch.exp(-torch.tensor(rows, dtype=torch.float64) / VARPHI)


def realised(worlds: int, cosines: int = 32, seed: int = 1) -> ShadowingField:
    return Shadowing(ZETA, VARPHI, cosines).realise(RandomStreams.worlds(seed, worlds))


def test_exact_samples_have_the_covariance():
    samples = 100_000
    white = RandomStreams.worlds(0, samples).normal(Stream.CHANNEL, 0, LINKS).view(samples, len(FIRST), len(SECOND))
    x = exact_shadowing(FIRST, SECOND, ZETA, VARPHI, white).flatten(1)
    expected = formula()
    # Of a Gaussian covariance: sqrt((c_ii c_jj + c_ij^2) / samples); 78 entries, none beyond 4.5.
    error = torch.sqrt((ZETA**4 + expected.square()) / samples)
    assert bool(((x.T @ x / samples - expected).abs() < 4.5 * error).all())
    assert bool((x.mean(0).abs() < 4.5 * ZETA / math.sqrt(samples)).all())


def test_spectral_sum_has_the_covariance():
    """Few cosines are not Gaussian, but their covariance is exact all the same."""
    worlds = 20_000
    x = realised(worlds)(*(end.expand(worlds, LINKS, 3) for end in ENDS))
    products = x[:, :, None] * x[:, None, :]
    error = products.std(0) / math.sqrt(worlds)
    assert bool(((products.mean(0) - formula()).abs() < 4.5 * error).all())
    assert bool((x.mean(0).abs() < 4.5 * ZETA / math.sqrt(worlds)).all())


@pytest.mark.parametrize(("cosines", "worlds"), [(4, 40_000), (256, 2_500)])
def test_kurtosis_of_a_sum_of_cosines(cosines: int, worlds: int):
    """The excess is -3 / (2 K), so that many cosines are nearly Gaussian."""
    point = tuple(end[:1].expand(worlds, 1, 3) for end in ENDS)
    fourth = (realised(worlds, cosines, seed=2)(*point).flatten() / ZETA).pow(4)
    assert float(fourth.mean()) == pytest.approx(3.0 - 1.5 / cosines, abs=4.0 * float(fourth.std()) / math.sqrt(worlds))


def test_differences_are_nearly_gaussian_with_many_cosines():
    worlds = 2_500
    pair = tuple(end[[0, 5]].expand(worlds, 2, 3) for end in ENDS)
    x = realised(worlds, 256, seed=3)(*pair).diff(dim=-1).flatten()
    fourth = (x / x.std()).pow(4)
    assert float(fourth.mean()) == pytest.approx(3.0, abs=4.0 * float(fourth.std()) / math.sqrt(worlds))


def test_radii_stand_in_their_bands():
    """F(r) = 2/pi (atan r - r / (1 + r^2)) of the radius of a three-dimensional Cauchy vector."""
    K = 1_000
    u = RandomStreams.worlds(5, 1).uniform(Stream.CHANNEL, 0, 3 * K).view(1, 3, K)
    omega = Shadowing(ZETA, VARPHI, K)._frequencies(torch.arange(K), *u.unbind(1))
    r = VARPHI * torch.linalg.vector_norm(omega[0], dim=-1)
    share = 2.0 / math.pi * (torch.atan(r) - r / (1.0 + r.square()))
    torch.testing.assert_close(share, (torch.arange(K) + u[0, 0]) / K, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("distance", [0.5, 5.0, 15.0, 50.0])
def test_frequencies_have_the_characteristic_function(distance: float):
    K = 100_000
    u = RandomStreams.worlds(6, 1).uniform(Stream.CHANNEL, 0, 3 * K).view(1, 3, K)
    omega = Shadowing(ZETA, VARPHI, K)._frequencies(torch.arange(K), *u.unbind(1))[0]
    direction = torch.tensor([2.0, -1.0, 2.0], dtype=torch.float64) / 3.0
    cos = torch.cos(distance * omega @ direction)
    bound = 4.0 * float(cos.std()) / math.sqrt(K)
    assert float(cos.mean()) == pytest.approx(math.exp(-distance / VARPHI), abs=bound)


def test_world_has_the_same_field_in_any_batch_and_order():
    together = realised(50)(*(end.expand(50, LINKS, 3) for end in ENDS))
    alone = Shadowing(ZETA, VARPHI, 32).realise(RandomStreams(torch.tensor([1]), torch.tensor([37])))
    order = torch.randperm(LINKS, generator=torch.Generator().manual_seed(0))
    first, second = (end[order].expand(1, LINKS, 3) for end in ENDS)
    torch.testing.assert_close(alone(first, second), together[37:38, order], rtol=0.0, atol=1e-12)
    for k in (0, 7):
        link = alone(first[:, k : k + 1], second[:, k : k + 1])
        torch.testing.assert_close(link, together[37:38, order[k : k + 1]], rtol=0.0, atol=1e-12)


def test_a_link_read_twice_has_the_same_shadowing():
    field = realised(3)
    ends = tuple(end.expand(3, LINKS, 3) for end in ENDS)
    before = field(*ends)
    field(*(end + 1.0 for end in ends))
    assert torch.equal(field(*ends), before)
    assert torch.equal(realised(3)(*ends), before)
    assert not bool(torch.isclose(realised(3, seed=2)(*ends), before).any())


def test_any_leading_dimensions():
    """A flight's steps stand before the worlds."""
    field = realised(3)
    moving = FIRST[:, None, None] + torch.zeros(3, 3, 1, 3, dtype=torch.float64)
    series = field(moving, SECOND[:1].expand(3, 3, 1, 3))
    for k in range(3):
        torch.testing.assert_close(series[k], field(moving[k], SECOND[:1].expand(3, 1, 3)), rtol=0.0, atol=1e-12)


def test_worlds_and_seeds_are_independent():
    worlds = 20_000
    point = tuple(end[:1].expand(worlds, 1, 3) for end in ENDS)
    x, y = (realised(worlds, 8, seed)(*point).flatten() / ZETA for seed in (1, 2))
    for product in (x[1:] * x[:-1], x * y):
        assert abs(float(product.mean())) < 4.0 * float(product.std()) / math.sqrt(worlds)


def test_no_shadowing_has_every_world():
    field = Shadowing(0.0, VARPHI).realise(RandomStreams.worlds(0, 4))
    assert field(FIRST[:1], SECOND[:1]).shape == (4, 1)


def test_no_shadowing_is_exactly_zero():
    field = Shadowing(0.0, VARPHI).realise(RandomStreams.worlds(0, 5))
    assert torch.equal(field(FIRST[:1].expand(5, 1, 3), SECOND.expand(5, 4, 3)), torch.zeros(5, 4).double())


@pytest.mark.parametrize("which", [0, 1])
def test_coincident_ends_cannot_be_sampled_exactly(which: int):
    ends = [FIRST, SECOND]
    ends[which] = ends[which][[0, 1, 1]]
    with pytest.raises(torch.linalg.LinAlgError):
        exact_shadowing(*ends, ZETA, VARPHI, torch.zeros(len(ends[0]), len(ends[1]), dtype=torch.float64))
