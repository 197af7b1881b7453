"""Places by search: the mean channel's without shadowing, SciPy's on a known peak, never worse than the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy import optimize
from torch import Tensor

from uwirl import build
from uwirl.motion.shadowed_targets import MOST_PLACES, LinkSnr, Search, shadowed_targets
from uwirl.motion.targets import mean_channel_targets
from uwirl.world.acoustics import Channel
from uwirl.world.fading import Shadowing
from uwirl.world.random import RandomStreams
from uwirl.world.scenario import Scenario

FINEST = Search().finest
DEPTH = 20.0


@pytest.fixture
def channel(make_config) -> Channel:
    return build.make_channel(make_config("channel=acoustic_24khz").channel)


@pytest.fixture
def scenario_of(make_config) -> Callable[[int], Scenario]:
    """The paper's nodes 84.9 m apart, and so many vehicles between them."""
    scenario = build.make_scenario(make_config())
    return lambda vehicles: replace(scenario, start=torch.zeros(vehicles, 4, dtype=torch.float64))


def mean_snr(channel: Channel, first: Tensor, second: Tensor) -> Tensor:
    return channel.mean_snr_dB(torch.linalg.vector_norm(first - second, dim=-1))


def spectral(channel: Channel, seed: int) -> LinkSnr:
    """Path loss and a random field, of few cosines to be quick."""
    field = Shadowing(3.0, 15.0, 16).realise(RandomStreams.worlds(seed, 1))
    return lambda p, q: mean_snr(channel, p, q) + field(p[None], q[None])[0]


def worst(scenario: Scenario, snr: LinkSnr, places: Tensor) -> float:
    """Of a chain's links, dB, the destination being the first end of its own."""
    nodes = [scenario.source, *places]
    links = [*pairwise(nodes), (scenario.destination, places[-1])]
    return min(float(snr(p[None], q[None])) for p, q in links)


def mean_targets(scenario: Scenario, channel: Channel) -> Tensor:
    return mean_channel_targets(scenario, channel).frame.target


def test_without_shadowing_one_vehicle_stays_at_the_midpoint(scenario_of, channel: Channel):
    scenario = scenario_of(1)
    places = shadowed_targets(scenario, partial(mean_snr, channel), mean_targets(scenario, channel))
    assert float((places - torch.tensor([0.0, 0.0, -8.0])).abs().max()) <= FINEST


@pytest.mark.parametrize("offset", [[1.0, 0.7, -0.4], [-7.3, 2.2, 5.1], [11.0, 11.0, 0.0]])
def test_without_shadowing_the_longer_hop_is_shortened(scenario_of, channel: Channel, offset: list[float]):
    """From elsewhere: half the span is the best there is, and the longer hop ends within a spacing of it."""
    scenario = scenario_of(1)
    displaced = torch.tensor([[0.0, 0.0, -8.0]], dtype=torch.float64) + torch.tensor(offset)
    (place,) = shadowed_targets(scenario, partial(mean_snr, channel), displaced).numpy()
    hops = [np.linalg.norm(place - end.numpy()) for end in (scenario.source, scenario.destination)]
    assert max(hops) <= np.hypot(30.0, 30.0) + FINEST


@pytest.mark.parametrize("vehicles", [2, 3])
def test_without_shadowing_equal_hops_stay(scenario_of, channel: Channel, vehicles: int):
    scenario = scenario_of(vehicles)
    targets, snr = mean_targets(scenario, channel), partial(mean_snr, channel)
    places = shadowed_targets(scenario, snr, targets)
    assert float((places - targets).abs().max()) <= FINEST
    assert worst(scenario, snr, places) >= worst(scenario, snr, targets)


def smooth_peak(channel: Channel, peak: list[float], height_dB: float, width_m: float) -> LinkSnr:
    """A hill on links of the source alone."""
    centre, source = torch.tensor(peak, dtype=torch.float64), torch.tensor([-30.0, -30.0, -8.0], dtype=torch.float64)

    def snr(first: Tensor, second: Tensor) -> Tensor:
        hill = height_dB * torch.exp(-(second - centre).square().sum(-1) / (2.0 * width_m**2))
        return mean_snr(channel, first, second) + torch.where((first == source).all(-1), hill, 0.0)

    return snr


@pytest.mark.parametrize("peak", [[8.0, 7.0, -9.0], [10.0, 3.0, -14.2], [4.0, 9.0, -3.3]])
def test_a_known_peak_is_scipys(scenario_of, channel: Channel, peak: list[float]):
    """Nearer to the destination, so that around it the source's link is the worse and the peak smooth."""
    scenario, height, width = scenario_of(1), 3.0, 4.0
    nodes, budget = (np.array([-30.0, -30.0, -8.0]), np.array([30.0, 30.0, -8.0])), channel.budget

    def links(p: np.ndarray) -> list[float]:
        """By NumPy alone."""
        lengths = [np.linalg.norm(p - node) for node in nodes]
        spread = (channel.K_dB - 10.0 * channel.n * np.log10(l) - budget.N0_dB for l in lengths)
        near, far = (s - budget.absorption_dB_per_km * l / 1000.0 for s, l in zip(spread, lengths, strict=True))
        return [near + height * np.exp(-np.sum((p - peak) ** 2) / (2.0 * width**2)), far]

    best = optimize.minimize(
        lambda p: -min(links(p)), peak, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-12}
    )
    assert links(best.x)[0] < links(best.x)[1] - 0.1
    assert -best.fun > min(links(np.array([0.0, 0.0, -8.0]))) + 0.5
    snr = smooth_peak(channel, peak, height, width)
    places = shadowed_targets(scenario, snr, mean_targets(scenario, channel))
    assert float(np.linalg.norm(places[0].numpy() - best.x)) <= FINEST
    assert worst(scenario, snr, places) <= -best.fun


@pytest.mark.parametrize("seed", range(3))
def test_random_fields_hide_nothing_better(scenario_of, channel: Channel, seed: int):
    """Against 20,000 places drawn at random within reach, the best 20 of them climbed by SciPy."""
    scenario, snr = scenario_of(1), spectral(channel, seed)
    places = shadowed_targets(scenario, snr, mean_targets(scenario, channel))

    def worth(p: np.ndarray) -> np.ndarray:
        q = torch.from_numpy(np.atleast_2d(p))
        return torch.minimum(*(snr(end.expand_as(q), q) for end in (scenario.source, scenario.destination))).numpy()

    box = [(-31.0, 31.0), (-31.0, 31.0), (-DEPTH, 0.0)]
    drawn = np.random.default_rng(seed).uniform(*np.transpose(box), (20_000, 3))
    best = drawn[worth(drawn).argsort()[-20:]]
    climbed = [-optimize.minimize(lambda p: -worth(p)[0], p, method="Nelder-Mead", bounds=box).fun for p in best]
    # A finest spacing leaves a peak of these fields that close.
    assert worst(scenario, snr, places) >= max(climbed) - 0.01


@pytest.mark.parametrize("vehicles", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_random_fields_are_never_worse_than_the_start(scenario_of, channel: Channel, seed: int, vehicles: int):
    """And places stay in the water and within reach, to which finer grids add less than a first spacing."""
    scenario, snr, search = scenario_of(vehicles), spectral(channel, seed), Search(spacing=3.0)
    targets = mean_targets(scenario, channel)
    places = shadowed_targets(scenario, snr, targets, search)
    assert worst(scenario, snr, places) > worst(scenario, snr, targets)
    assert bool(((places[:, 2] >= -DEPTH) & (places[:, 2] <= 0.0)).all())
    hop = 2.0 * np.hypot(30.0, 30.0) / (vehicles + 1)
    assert float((places - targets)[:, :2].abs().max()) <= search.reach * hop + search.spacing


@pytest.mark.parametrize(("depth", "upwards", "end"), [(11.0, 1.0, 0.0), (11.0, -1.0, -11.0), (20.0, -1.0, -20.0)])
def test_surface_and_floor_bound_the_search(scenario_of, channel: Channel, depth: float, upwards: float, end: float):
    """Better and better one way."""
    scenario = replace(scenario_of(1), depth=depth)
    places = shadowed_targets(scenario, lambda _, q: upwards * q[:, 2], mean_targets(scenario, channel))
    assert float(places[0, 2]) == end


@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_ends_stand_in_the_order_of_the_field(scenario_of, channel: Channel, vehicles: int):
    """Source < destination < vehicles, and these as in the chain, which a small reach keeps apart."""
    scenario, seen = scenario_of(vehicles), []

    def snr(first: Tensor, second: Tensor) -> Tensor:
        assert first.shape == second.shape
        seen.append((first, second))
        return mean_snr(channel, first, second)

    shadowed_targets(scenario, snr, mean_targets(scenario, channel), Search(reach=0.2))
    first, second = (torch.cat(ends) for ends in zip(*seen, strict=True))
    of_source, of_destination = ((first == end).all(-1) for end in (scenario.source, scenario.destination))
    for end in (scenario.source, scenario.destination):
        assert not bool((second == end).all(-1).any())
    assert bool(of_source.any())
    assert bool(of_destination.any())
    between = ~(of_source | of_destination)
    assert bool(between.any()) == (vehicles > 1)
    along = (second - first)[between] @ (scenario.destination - scenario.source)
    assert bool((along > 0.0).all())


@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_ties_stay(scenario_of, channel: Channel, vehicles: int):
    scenario = scenario_of(vehicles)
    targets = mean_targets(scenario, channel)
    assert torch.equal(shadowed_targets(scenario, lambda p, q: 0.0 * (p + q)[:, 0], targets), targets)


def test_targets_keep_their_dtype(scenario_of, channel: Channel):
    scenario = scenario_of(2)
    targets = mean_targets(scenario, channel)
    half = shadowed_targets(scenario, spectral(channel, 0), targets.float(), Search(spacing=3.0))
    whole = shadowed_targets(scenario, spectral(channel, 0), targets.float().double(), Search(spacing=3.0))
    assert torch.equal(half, whole.float())


@pytest.mark.parametrize("length", [0.5, 100.0, 1e4])
@pytest.mark.parametrize(("depth", "vehicles"), [(20.0, 1), (20.0, 10), (6e3, 3)])
def test_no_world_needs_more_places_than_memory_holds(
    scenario_of, channel: Channel, length: float, depth: float, vehicles: int
):
    """And none ends worse than it began."""
    ends = (torch.tensor([side * length, 0.0, -8.0], dtype=torch.float64) for side in (-0.5, 0.5))
    scenario = replace(scenario_of(vehicles), depth=depth, **dict(zip(("source", "destination"), ends, strict=True)))
    targets, seen = mean_targets(scenario, channel), []

    def snr(first: Tensor, second: Tensor) -> Tensor:
        seen.append(len(first))
        return mean_snr(channel, first, second)

    places = shadowed_targets(scenario, snr, targets)
    assert max(seen) < 1.2 * MOST_PLACES / vehicles + 3
    assert worst(scenario, snr, places) >= worst(scenario, snr, targets)
