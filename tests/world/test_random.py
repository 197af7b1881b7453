"""Random streams: Philox against Random123's vectors, independence of the batch, and distributions."""

from __future__ import annotations

import pytest
import torch
from scipy import stats

from uwirl.world.random import RandomStreams, Stream, philox4x32

DRAWS = 100_000

# counter, key, result: kat_vectors of Random123 (https://github.com/DEShawResearch/random123), philox4x32 10.
KNOWN_ANSWERS = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


def words(text: str) -> torch.Tensor:
    return torch.tensor([int(word, 16) for word in text.split()])


@pytest.mark.parametrize(("counter", "key", "result"), KNOWN_ANSWERS)
def test_philox_known_answer(counter: str, key: str, result: str):
    assert philox4x32(words(counter), words(key)).tolist() == words(result).tolist()


def test_philox_batch_equals_singles():
    columns = zip(*KNOWN_ANSWERS, strict=True)
    counters, keys, results = (torch.stack([words(text) for text in column]) for column in columns)
    assert torch.equal(philox4x32(counters, keys), results)


def test_uniform_holds_53_bits_of_two_words():
    # Seed, world, step and stream 0 are the first vector; genrand_res53 of the Mersenne Twister joins its words.
    a, b, c, d = words(KNOWN_ANSWERS[0][2]).tolist()
    expected = [((high >> 5) * 67108864.0 + (low >> 6)) / 9007199254740992.0 for high, low in ((a, b), (c, d))]
    assert RandomStreams.worlds(0, 1).uniform(Stream.CHANNEL, 0, 2)[0].tolist() == expected


@pytest.mark.parametrize("draw", ["uniform", "normal"])
def test_world_draws_the_same_in_any_batch(draw: str):
    many = getattr(RandomStreams.worlds(7, 50), draw)(Stream.MEASUREMENT, 3, 9)
    few = getattr(RandomStreams.worlds(7, 4), draw)(Stream.MEASUREMENT, 3, 9)
    alone = getattr(RandomStreams(torch.tensor([7]), torch.tensor([37])), draw)(Stream.MEASUREMENT, 3, 9)
    assert torch.equal(many[:4], few)
    assert torch.equal(many[37:38], alone)


@pytest.mark.parametrize("draw", ["uniform", "normal"])
def test_more_draws_begin_with_the_same(draw: str):
    streams = RandomStreams.worlds(7, 3)
    assert torch.equal(getattr(streams, draw)(Stream.CHANNEL, 0, 11)[:, :4], getattr(streams, draw)(0, 0, 4))


@pytest.mark.parametrize("draw", ["uniform", "normal"])
def test_a_step_of_each_world_or_several_of_one(draw: str):
    step = torch.tensor([4, 0, 2**31 + 5])
    several, one = RandomStreams.worlds(7, 3), RandomStreams(torch.tensor([7]), torch.tensor([1]))
    together, in_one = (getattr(streams, draw)(Stream.NAVIGATION, step, 5) for streams in (several, one))
    for k in range(3):
        alone = getattr(several, draw)(Stream.NAVIGATION, int(step[k]), 5)
        assert torch.equal(together[k], alone[k])
        assert torch.equal(in_one[k], alone[1])


def test_replicates_are_world_zero_of_each_seed():
    seeds = [5, 0, 2**40 + 1, -3]
    together = RandomStreams.replicates(seeds).uniform(Stream.EXPLORATION, 2, 6)
    separate = [RandomStreams.worlds(seed, 3).uniform(Stream.EXPLORATION, 2, 6)[0] for seed in seeds]
    assert torch.equal(together, torch.stack(separate))


def test_any_other_coordinate_gives_other_draws():
    rows = [RandomStreams.worlds(seed, 1).uniform(Stream.CHANNEL, 0, 4)[0] for seed in (0, 1, -1, 2**32, 2**33)]
    rows += [RandomStreams.worlds(0, 1).uniform(stream, 0, 4)[0] for stream in list(Stream)[1:]]
    rows += [RandomStreams.worlds(0, 1).uniform(Stream.CHANNEL, step, 4)[0] for step in (1, 2, 2**31)]
    rows += list(RandomStreams.worlds(0, 4).uniform(Stream.CHANNEL, 0, 4)[1:])
    numbers = torch.cat(rows)
    assert len(numbers.unique()) == len(numbers)


def test_uniform_is_uniform():
    draws = RandomStreams.worlds(1, DRAWS // 10).uniform(Stream.CHANNEL, 0, 10).flatten()
    assert float(draws.min()) >= 0.0
    assert float(draws.max()) < 1.0
    assert stats.kstest(draws.numpy(), "uniform").pvalue > 0.01


def test_between_fills_its_interval():
    draws = RandomStreams.worlds(2, DRAWS // 10).between(Stream.CHANNEL, 0, -3.0, 5.0, 10).flatten()
    assert stats.kstest(draws.numpy(), stats.uniform(-3.0, 8.0).cdf).pvalue > 0.01


@pytest.mark.parametrize("count", [10, 5])
def test_normal_is_standard_normal(count: int):
    draws = RandomStreams.worlds(3, DRAWS // count).normal(Stream.DISTURBANCE, 0, count).flatten()
    assert len(draws) == DRAWS
    assert stats.kstest(draws.numpy(), "norm").pvalue > 0.01


def test_draws_of_a_world_and_of_neighbours_are_uncorrelated():
    draws = RandomStreams.worlds(4, DRAWS // 10).normal(Stream.CHANNEL, 0, 6)
    columns = torch.cat([draws[:-1], draws[1:]], 1)
    correlation = torch.corrcoef(columns.T) - torch.eye(12)
    # 66 coefficients of standard deviation 1 / sqrt(10^4): none beyond 4.
    assert float(correlation.abs().max()) < 4.0 / (DRAWS // 10) ** 0.5
