"""The channel: the paper's capacities to their printed digits, monotonicity, and per-vehicle parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import pytest
import torch

from uwirl import build
from uwirl.config.compose import folder
from uwirl.world.absorption import Water, thorp
from uwirl.world.acoustics import Channel, LinkBudget

CHANNELS = sorted(path.stem for path in (folder() / "channel").glob("*.yaml"))


@pytest.fixture
def channel(request: pytest.FixtureRequest, make_config) -> Channel:
    return build.make_channel(make_config(f"channel={request.param}").channel)


# From the start (29.5, 29.5, 0) to the source, and half and a third of the link between (-30, -30) and (30, 30).
@pytest.mark.parametrize(
    ("distance", "printed_distance", "printed"),
    [
        (math.hypot(59.5, 59.5, 8.0), "84.525", "17.302"),
        (30.0 * math.sqrt(2.0), "42.426", "62.045"),
        (20.0 * math.sqrt(2.0), "28.284", "91.122"),
    ],
)
@pytest.mark.parametrize("channel", ["paper"], indirect=True)
def test_paper_capacities(channel: Channel, distance: float, printed_distance: str, printed: str):
    assert f"{distance:.3f}" == printed_distance
    assert f"{float(channel.mean_capacity_kbps(torch.tensor(distance, dtype=torch.float64))):.3f}" == printed


@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_capacity_falls_with_distance(channel: Channel):
    capacity = channel.mean_capacity_kbps(torch.logspace(-1, 4, 2001, dtype=torch.float64))
    assert bool((capacity.diff() < 0.0).all())
    assert bool((capacity > 0.0).all())


@pytest.mark.parametrize("channel", ["acoustic_24khz"], indirect=True)
def test_absorption_counts_per_kilometre(channel: Channel):
    near, far = channel.mean_snr_dB(torch.tensor([1000.0, 2000.0], dtype=torch.float64)).tolist()
    assert near - far == pytest.approx(20.0 * math.log10(2.0) + thorp(24.0, Water()), abs=1e-10)


@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_snr_is_path_loss_less_known_loss(channel: Channel):
    distance = torch.tensor([0.5, 1.0, 42.0, 900.0], dtype=torch.float64)
    path_loss = [channel.K_dB - 10.0 * channel.n * math.log10(d) for d in distance.tolist()]
    snr = channel.mean_snr_dB(distance) + channel.budget.known_loss_dB(distance)
    assert snr.tolist() == pytest.approx(path_loss, rel=1e-13)


@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_very_low_snr_keeps_its_capacity(channel: Channel):
    capacity = float(channel.capacity_kbps(torch.tensor(-200.0, dtype=torch.float64)))
    # log2(1 + s) -> s / ln 2, where 1 + s rounds to 1.
    assert capacity == pytest.approx(channel.budget.bandwidth_khz * 1e-20 / math.log(2.0), rel=1e-12, abs=0.0)


def test_missing_frequency_raises():
    channel = Channel(LinkBudget(N0_dB=-104.0, bandwidth_khz=6.0, absorption="thorp"), K_dB=-60.0, n=2.0)
    with pytest.raises(ValueError, match=r"channel\.frequency_khz.*thorp.*kHz"):
        channel.mean_snr_dB(torch.ones(1))


@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_capacity_and_snr_are_inverse(channel: Channel):
    for snr_dB in (-20.0, 0.0, 17.5, 60.0):
        capacity = float(channel.capacity_kbps(torch.tensor(snr_dB, dtype=torch.float64)))
        assert channel.budget.snr_for_dB(capacity) == pytest.approx(snr_dB, abs=1e-10)


def test_vehicles_may_have_channels_of_their_own():
    """Vehicles count on over all worlds: the third is the first one of the second world."""
    K, n = torch.tensor([-60.0, -50.0]), torch.tensor([2.0, 1.5])
    channel = Channel(LinkBudget(-104.0, 6.0), K, n, zeta_dB=torch.tensor([3.0, 1.0]), rho_dB=1.0)
    distance = torch.tensor([10.0, 100.0], dtype=torch.float64)
    assert channel.mean_snr_dB(distance).tolist() == pytest.approx([-60.0 - 20.0 + 104.0, -50.0 - 30.0 + 104.0])
    picked = channel.of(torch.tensor([1, 2, 3]))
    assert picked.K_dB.tolist() == [-50.0, -60.0, -50.0]
    assert picked.n.tolist() == [1.5, 2.0, 1.5]
    assert picked.zeta_dB.tolist() == [1.0, 3.0, 1.0]
    assert picked.rho_dB == 1.0
    assert picked.budget is channel.budget


def test_without_fading_a_channel_is_its_mean():
    channel = Channel(LinkBudget(-104.0, 6.0), -60.0, 2.0)
    assert (channel.zeta_dB, channel.rho_dB) == (0.0, 0.0)
    assert math.isinf(channel.varphi_m)


@pytest.mark.parametrize("capacity", [1e-9, 0.5, 17.302, 62.045, 400.0])
@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_snr_for_a_capacity_carries_it(channel: Channel, capacity: float):
    snr = torch.tensor(channel.budget.snr_for_dB(capacity), dtype=torch.float64)
    assert float(channel.capacity_kbps(snr)) == pytest.approx(capacity, rel=1e-12)


@pytest.mark.parametrize("channel", CHANNELS, indirect=True)
def test_a_channel_keeps_what_it_is_made_of(channel: Channel):
    """An estimate's values in place of the true ones change nothing else."""
    believed = replace(channel, K_dB=torch.tensor([1.0, 2.0]), n=torch.tensor([3.0, 4.0]))
    assert believed.budget == channel.budget
    assert replace(believed, K_dB=channel.K_dB, n=channel.n) == channel
    assert Channel(replace(channel.budget), *(getattr(channel, f.name) for f in fields(Channel)[1:])) == channel


@dataclass(frozen=True)
class NoisyBudget(LinkBudget):
    """Ship noise by distance, and a modem that stops at a rate."""

    most_kbps: float = 20.0

    def known_loss_dB(self, distance_m: torch.Tensor) -> torch.Tensor:
        return super().known_loss_dB(distance_m) + 0.5 * distance_m

    def capacity_kbps(self, snr_dB: torch.Tensor) -> torch.Tensor:
        return super().capacity_kbps(snr_dB).clamp_max(self.most_kbps)


def test_a_budget_of_ones_own_counts_everywhere():
    """In the mean SNR, in capacities, and behind `of`."""
    plain, own = LinkBudget(-104.0, 6.0), NoisyBudget(-104.0, 6.0)
    distance = torch.tensor([2.0, 20.0, 60.0], dtype=torch.float64)
    before, after = (Channel(budget, -60.0, 2.0).mean_snr_dB(distance) for budget in (plain, own))
    torch.testing.assert_close(before - after, 0.5 * distance, rtol=1e-12, atol=0.0)
    channel = Channel(own, torch.tensor([-60.0]), torch.tensor([2.0])).of(torch.tensor([0]))
    capacity = channel.mean_capacity_kbps(distance)
    shannon = 6.0 * torch.log2(1.0 + 10.0 ** (after / 10.0))
    torch.testing.assert_close(capacity, shannon.clamp_max(20.0), rtol=1e-12, atol=0.0)
    assert float(capacity[0]) == 20.0 > float(capacity[1]) > 0.0
