"""Absorption laws against published values, their limits, and their place in the link budget."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch

from uwirl.config.world_schema import Absorption
from uwirl.world.absorption import ABSORPTION_LAWS, Water, fisher_simmons, francois_garrison, thorp
from uwirl.world.acoustics import LinkBudget

LAWS = sorted(ABSORPTION_LAWS)


def test_configuration_knows_the_laws():
    assert tuple(Absorption) == ("none", *ABSORPTION_LAWS)


@pytest.mark.parametrize(("frequency", "printed"), [(1, "0.0690"), (10, "1.187"), (24, "5.691"), (50, "17.467")])
def test_thorp_printed_values(frequency: float, printed: str):
    digits = len(printed.split(".")[1])
    assert f"{thorp(frequency, Water()):.{digits}f}" == printed


@pytest.mark.parametrize(
    ("frequency", "water", "published"),
    [(50.0, Water(27.0, 35.0, 10.0, 8.1), "10.71"), (24.0, Water(10.0, 35.0, 0.0, 8.0), "4.649")],
)
def test_francois_garrison_published_values(frequency: float, water: Water, published: str):
    digits = len(published.split(".")[1])
    assert f"{francois_garrison(frequency, water):.{digits}f}" == published


def test_fisher_simmons_published_value():
    """Table IV: 0.52 dB/km at 10 kHz, 4 degrees Celsius and 500 atm."""
    assert f"{fisher_simmons(10.0, Water(4.0, depth_m=5000.0)):.2f}" == "0.52"


@pytest.mark.parametrize("temperature", [4.0, 30.0])
def test_fresh_water_absorbs_by_viscosity_alone(temperature: float):
    """A_3 P_3 f^2 of Francois and Garrison, whose coefficients change at 20 degrees."""
    cold, warm = (4.937e-4, -2.59e-5, 9.11e-7, -1.50e-8), (3.964e-4, -1.146e-5, 1.45e-7, -6.5e-10)
    A3 = sum(a * temperature**k for k, a in enumerate(cold if temperature <= 20.0 else warm))
    P3 = 1.0 - 3.83e-5 * 200.0 + 4.9e-10 * 200.0**2
    law = francois_garrison(100.0, Water(temperature, 1e-12, 200.0, 7.0))
    assert law == pytest.approx(A3 * P3 * 100.0**2, rel=1e-3)


@pytest.mark.parametrize("name", LAWS)
def test_higher_notes_are_absorbed_more(name: str):
    rates = [ABSORPTION_LAWS[name](f, Water()) for f in torch.logspace(-0.5, 2.5, 301).tolist()]
    assert all(high > low > 0.0 for low, high in pairwise(rates))


@pytest.mark.parametrize("name", LAWS)
def test_budget_uses_the_chosen_law_per_kilometre(name: str):
    water = Water(5.0, 33.0, 40.0, 7.9)
    budget = LinkBudget(-104.0, 6.0, absorption=name, frequency_khz=24.0, water=water)
    near, far = budget.known_loss_dB(torch.tensor([0.0, 1000.0], dtype=torch.float64)).tolist()
    assert near == -104.0
    assert far - near == pytest.approx(ABSORPTION_LAWS[name](24.0, water), rel=1e-12)


def test_no_absorption_leaves_the_noise():
    assert LinkBudget(-104.0, 6.0).known_loss_dB(torch.tensor([1.0, 1e5])).tolist() == [-104.0, -104.0]
