"""What cannot be true of readings is told, each kind by its own sentence; healthy readings are not accused."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from dense import simulate
from torch import Tensor

from uwirl import Channel, LinkBudget
from uwirl.snr.estimators import disk, maximum_likelihood
from uwirl.snr.plausibility import ImplausibleError, check_units, implausible
from uwirl.world.geometry import distances
from uwirl.world.readings import Readings

BUDGET = LinkBudget(N0_dB=-104.0, bandwidth_khz=6.0)
CHANNEL = Channel(BUDGET, K_dB=-60.0, n=2.0)


def positions(count: int, seed: int = 3) -> Tensor:
    """In a box of 200 m x 120 m around (-40, 30), 4 to 20 m deep; its axes are not alike."""
    uniform = torch.rand(count, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return uniform * torch.tensor([200.0, 120.0, -16.0]) + torch.tensor([-140.0, -30.0, -4.0])


def site(senders: int = 6, sensors: int = 5) -> tuple[Tensor, Tensor, Tensor]:
    """Positions of senders and sensors, and SNR with 1 dB of multipath."""
    T, R = positions(senders), positions(sensors, 4)
    noise = torch.randn(senders, sensors, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    return T, R, CHANNEL.mean_snr_dB(distances(T, R)) + noise


def told(T: Tensor, R: Tensor, snr: Tensor, budget: LinkBudget = BUDGET) -> list[str]:
    readings = Readings(T, R, snr[None])
    return list(implausible(readings, maximum_likelihood(readings, budget)))


def scaled(end: Tensor, *factors: float) -> Tensor:
    return end * end.new_tensor(factors)


def absorbed(f: float) -> LinkBudget:
    return LinkBudget(N0_dB=-104.0, bandwidth_khz=6.0, absorption="thorp", frequency_khz=f)


def around(T: Tensor, R: Tensor, snr: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Sensors at 60 to 60.004 m from the first sender."""
    direction = torch.nn.functional.normalize(R - T[:1], dim=1)
    return T[:1], T[:1] + direction * torch.linspace(60.0, 60.004, len(R), dtype=torch.float64)[:, None], snr[:1]


FAULTS: dict[str, tuple[Callable[..., tuple], str]] = {
    "depth for z at the sensors": (
        lambda T, R, y: (T, scaled(R, 1, 1, -1), y),
        "if sensor_z_m is depth, turn its sign",
    ),
    "depth for z at the vehicle": (
        lambda T, R, y: (scaled(T, 1, 1, -1), R, y),
        "if vehicle_z_m is depth, turn its sign",
    ),
    "depth for z": (lambda T, R, y: (scaled(T, 1, 1, -1), scaled(R, 1, 1, -1), y), "turn its sign in both columns"),
    "millimetres": (lambda T, R, y: (1e3 * T, 1e3 * R, y), "deeper than any sea; are positions in millimetres"),
    "kilometres": (
        lambda T, R, y: (1e-3 * T, 1e-3 * R, y),
        "no link is longer than 0.2 m; are positions in kilometres",
    ),
    "vehicle on a grid, sensors on the site": (
        lambda T, R, y: (T + scaled(T / T, 5e5, 4e6, 0), R, y),
        "km long in the",
    ),
    "x for y": (lambda T, R, y: (T[:, [1, 0, 2]], R, y), "with x and y of the sensors (or of the vehicles) exchanged"),
    "west for east": (lambda T, R, y: (scaled(T, -1, 1, 1), R, y), "with the sign of x of the sensors (or of the"),
    "south for north": (lambda T, R, y: (T, scaled(R, 1, -1, 1), y), "with the sign of y of the sensors (or of the"),
    "centimetres at the vehicle": (lambda T, R, y: (1e2 * T, R, y), "with vehicles in cm readings scatter by"),
    "feet at the sensors": (lambda T, R, y: (T, R / 0.3048, y), "with sensors in feet readings scatter by"),
    "kilometres at the sensors": (
        lambda T, R, y: (T, 1e-3 * R, y),
        "with vehicles in mm (or sensors in km) readings scatter by",
    ),
    "received power": (lambda T, R, y: (T, R, y - 90.0), "is it received power (dBm)"),
    "received level": (lambda T, R, y: (T, R, y + 104.0), "is it a received level (dB re 1 uPa)"),
    "loss": (lambda T, R, y: (T, R, 44.0 - y), "the SNR grows with distance; is snr_dB a loss"),
    "no distance": (
        lambda T, R, y: (T, R, 10.0 + 0.1 * (y - CHANNEL.mean_snr_dB(distances(T, R)))),
        "hardly falls with",
    ),
    "a placeholder": (lambda T, R, y: (T, R, 0.0 * y + 9.0), "all readings are 9 dB, at any distance"),
    "a limit": (
        lambda T, R, y: (T, R, y.clamp(max=float(y.median()) - 1.0)),
        "dB, the largest; is that the receiver's limit",
    ),
    "Hz for kHz": (
        lambda T, R, y: (T, R, y, absorbed(2400.0)),
        "or is the absorption of channel.frequency_khz too much",
    ),
    "too loud": (lambda T, R, y: (10 * T, 10 * R, 2.75 * y + 165.0), "louder than any source"),
    "too steep": (lambda T, R, y: (T, R, 4.0 * y - 20.0), "falls faster than at sea"),
    "one distance": (around, "m do not tell how the SNR falls with distance"),
    "SNR of others": (lambda T, R, y: (T, R, 8.0 * (y.flip(0, 1) - y.mean())), "more than at sea"),
}


def test_healthy_readings_are_not_accused():
    assert told(*site()) == []


@pytest.mark.parametrize(("fault", "sentence"), FAULTS.values(), ids=FAULTS)
def test_each_fault_has_its_sentence(fault: Callable[..., tuple], sentence: str):
    found = told(*fault(*site()))
    assert any(sentence in text for text in found), found


def test_the_disk_model_says_nothing_of_distance():
    T, R, y = site()
    readings = Readings(T, R, y[None])
    assert list(implausible(readings, disk(readings, BUDGET))) == []


@pytest.mark.parametrize("level", [True, False], ids=["one depth", "several depths"])
@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2]], ids=["longitude first", "latitude first"])
def test_degrees_are_refused(order: list[int], level: bool):
    T, R, y = site()
    if level:
        T[:, 2] = R[:, 2] = -5.0
    metres = torch.tensor([111_195.0 * 0.5, 111_195.0, 1.0], dtype=torch.float64)
    # At 60 degrees north a degree of longitude is half a degree of latitude; the site is 200 m wide.
    T, R = ((end / metres + scaled(metres / metres, 10.0, 60.0, 0.0))[:, order] for end in (T, R))
    with pytest.raises(
        ImplausibleError, match=r"^x \(.*\) and y \(.*\) look like degrees; positions must be in metres"
    ):
        check_units(Readings(T, R, y[None]), BUDGET)


def wobbling(centre: list[float], reach: list[float]) -> Tensor:
    """Twenty positions around a point, [20, 3]."""
    uniform = 2.0 * torch.rand(20, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64) - 1.0
    return uniform * uniform.new_tensor(reach) + uniform.new_tensor(centre)


@pytest.mark.parametrize(
    ("T", "R"),
    [
        # A navigation with some centimetres of noise, and one without.
        (wobbling([10.0, 54.0, -25.0], [0.05, 0.05, 19.0]), [10.0, 54.0, -1.0]),
        (wobbling([10.0, 54.0, -25.0], [0.0, 0.0, 19.0]), [10.0, 54.0, -1.0]),
        (wobbling([6.0, 4.0, -0.5], [0.4, 0.4, 0.3]), [6.1, 4.2, -0.1]),
        (wobbling([5e5, 4e6, -0.5], [0.4, 0.4, 0.3]), [5e5, 4e6, -0.1]),
    ],
    ids=["cast", "exact cast", "tank", "tank in UTM"],
)
def test_metres_are_not_taken_for_degrees(T: Tensor, R: list[float]):
    places = T, T.new_tensor([R])
    noise = torch.randn(20, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    check_units(Readings(*places, (CHANNEL.mean_snr_dB(distances(*places)) + noise)[None]), BUDGET)


@pytest.mark.parametrize("messages", [1, 4])
def test_warnings_of_healthy_readings_are_rare(channel: Channel, messages: int):
    """docs/channel.md has rates from more data sets and geometries."""
    sets = 60
    readings = simulate(channel, 16 // messages, messages, sets, seed=messages)
    estimate = maximum_likelihood(readings, channel.budget)
    accused = 0
    for k in range(sets):
        check_units(readings.select(slice(k, k + 1)), channel.budget)
        accused += any(implausible(readings.select(slice(k, k + 1)), estimate.select(torch.tensor([k]))))
    assert accused <= 1
