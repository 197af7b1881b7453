"""The truth: links by hand, shadowing that stays, and that whoever estimates or plans cannot reach it."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import Tensor

from uwirl.algorithm import algorithm_1
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.estimators import maximum_likelihood
from uwirl.world.acoustics import Channel, LinkBudget
from uwirl.world.agent import Agent
from uwirl.world.random import RandomStreams
from uwirl.world.readings import Readings
from uwirl.world.relay import Relay
from uwirl.world.scenario import spread_sensors
from uwirl.world.truth import Truth, truth_of

SOURCE, DESTINATION = [-30.0, -30.0, -8.0], [30.0, 30.0, -8.0]
START = [[-12.0, -9.0, -7.0], [10.0, 11.0, -6.0]]
WORLDS = 5


def tensor(values: list) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def faded(env: Relay, **channel: float) -> Truth:
    other = Relay(env.scenario, env.vehicle, replace(truth_of(env).channel, **channel), env.streams)
    return truth_of(other)


@pytest.fixture
def shadowed(env: Relay) -> Truth:
    return faded(env, zeta_dB=3.0, varphi_m=15.0)


@pytest.fixture
def position(env: Relay) -> Tensor:
    return env.start().vehicles.position


def test_chain_runs_from_source_to_destination(env: Relay, position: Tensor):
    assert torch.equal(truth_of(env).chain(position), tensor([SOURCE, *START, DESTINATION]).expand(WORLDS, 4, 3))


def test_link_capacities_by_hand(env: Relay):
    expected = []
    for p, q in pairwise([SOURCE, *START, DESTINATION]):
        snr_dB = -60.0 - 50.0 * math.log10(math.dist(p, q)) + 160.0
        expected.append(10.0 * math.log2(1.0 + 10.0 ** (snr_dB / 10.0)))
    assert truth_of(env).link_capacities_kbps(tensor(START)).tolist() == pytest.approx(expected, rel=1e-12)


def test_even_chain_of_two_reaches_the_papers_capacity(env: Relay):
    even = tensor([[-10.0, -10.0, -8.0], [10.0, 10.0, -8.0]]).expand(WORLDS, 2, 3)
    links = truth_of(env).link_capacities_kbps(even)
    assert links.shape == (WORLDS, 3)
    assert [f"{c:.3f}" for c in links.flatten().tolist()] == ["91.122"] * (3 * WORLDS)


def test_shadowed_capacities_by_hand(shadowed: Truth, position: Tensor):
    """The field's ends stand in the order source, destination, vehicles."""
    nodes = [tensor(SOURCE).expand(WORLDS, 3), *position.unbind(-2), tensor(DESTINATION).expand(WORLDS, 3)]
    expected = []
    for p, q in [(nodes[0], nodes[1]), (nodes[1], nodes[2]), (nodes[3], nodes[2])]:
        fading = shadowed.shadowing(p[:, None], q[:, None])[:, 0]
        snr = shadowed.channel.mean_snr_dB(torch.linalg.vector_norm(p - q, dim=-1)) + fading
        expected.append(shadowed.channel.capacity_kbps(snr))
    links = shadowed.link_capacities_kbps(position, shadowed=True)
    torch.testing.assert_close(links, torch.stack(expected, -1), rtol=1e-12, atol=0.0)
    assert not bool(torch.isclose(links, shadowed.link_capacities_kbps(position)).any())


def test_a_link_has_the_same_shadowing_whenever_it_is_read(env: Relay, shadowed: Truth, position: Tensor):
    moved = torch.stack([position, position + 1.0, position])
    series = shadowed.link_capacities_kbps(moved, shadowed=True)
    assert torch.equal(series[0], series[2])
    assert not bool(torch.isclose(series[0], series[1]).any())
    # The first link does not feel where the second vehicle is, nor its world how many others there are.
    other = position.clone()
    other[:, 1] += 5.0
    assert torch.equal(shadowed.link_capacities_kbps(other, shadowed=True)[:, 0], series[0, :, 0])
    single = faded(env.select(torch.tensor([3])), zeta_dB=3.0, varphi_m=15.0)
    alone = single.link_capacities_kbps(position[3:4], shadowed=True)
    torch.testing.assert_close(alone, series[0, 3:4], rtol=1e-12, atol=0.0)


def test_without_shadowing_capacities_are_the_mean(env: Relay, position: Tensor):
    still = faded(env, zeta_dB=0.0)
    assert torch.equal(still.link_capacities_kbps(position, shadowed=True), still.link_capacities_kbps(position))


def test_snr_of_links_by_hand(make_relay):
    """K - 10 n log10(l) - a l / 1000 - N0 and the first world's field; links of a chain, and so its capacities."""
    env = make_relay("channel=acoustic_24khz", streams=RandomStreams.worlds(4, 3))
    q = spread_sensors(20, 5, SOURCE, DESTINATION, torch.float64)
    alone, capacity = truth_of(env.select(torch.tensor([0]))), []
    for node in (SOURCE, DESTINATION):
        p = tensor(node).expand_as(q)
        lengths = np.linalg.norm(p.numpy() - q.numpy(), axis=-1)
        mean = -60.0 - 20.0 * np.log10(lengths) - env.budget.absorption_dB_per_km * lengths / 1000.0 + 104.0
        snr, fading = truth_of(env).snr_dB(p, q).numpy(), alone.shadowing(p[None], q[None])[0].numpy()
        np.testing.assert_allclose(snr, mean + fading, rtol=0.0, atol=1e-10)
        capacity.append(6.0 * np.log2(1.0 + 10.0 ** (snr / 10.0)))
    links = alone.link_capacities_kbps(q[:, None, None], shadowed=True)[:, 0]
    np.testing.assert_allclose(links, np.stack(capacity, -1), rtol=1e-10)


def test_worlds_taken_out_and_other_worlds_have_the_same_channel(env: Relay):
    channel = truth_of(env).channel
    assert truth_of(env.select(torch.tensor([1, 3]))).channel is channel
    assert truth_of(env.on(env.scenario, env.streams)).channel is channel
    assert env.budget is channel.budget


# What there is to know of a channel, and nobody is told.
SECRET = sorted({field.name for field in fields(Channel)} - {"budget"})


@pytest.mark.parametrize("name", SECRET)
def test_an_estimator_cannot_look_up_what_it_should_estimate(env: Relay, name: str):
    """It is given readings and a budget, and these hold none of it."""

    def cheat(readings: Readings, budget: LinkBudget) -> ChannelEstimate:
        assert not hasattr(readings, name)
        return getattr(budget, name)

    with pytest.raises(AttributeError, match=f"'LinkBudget' object has no attribute '{name}'"):
        next(algorithm_1(env, cheat, planner=None))


@pytest.mark.parametrize("name", ["channel", "shadowing", "snr_dB", "link_capacities_kbps", "chain"])
def test_a_planner_cannot_plan_on_the_truth(make_pair, name: str):
    """It is given worlds to fly in and an estimate."""

    class Cheat:
        def fit(self, env: Relay, estimate: ChannelEstimate) -> Agent:
            return getattr(env, name)

    env = make_pair("channel=acoustic_24khz", worlds=1)
    *_, planned = algorithm_1(env, maximum_likelihood, Cheat())
    with pytest.raises(AttributeError, match=f"'Relay' object has no attribute '{name}'"):
        planned.agent_in(env)
