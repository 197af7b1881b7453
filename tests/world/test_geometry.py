"""Geometry: both turns are each other's inverse and J(psi)'s blocks, angles wrap as the math library's do."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from uwirl.world.geometry import (
    distances,
    left_of,
    rotation_matrix,
    to_body,
    to_inertial,
    turned_to_body,
    turned_to_inertial,
    unit_vector,
    wrapped,
)

COUNT = 1_000


def uniform(*shape: int, within: float, seed: int = 0) -> Tensor:
    draws = torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return within * (2.0 * draws - 1.0)


# Many turns either way, and what is exact or nearly so.
PSI = torch.cat([uniform(COUNT, within=50.0), torch.tensor([0.0, math.pi / 2, math.pi, -math.pi, 1e-9]).double()])
VECTOR = uniform(len(PSI), 4, within=10.0, seed=1)


def test_turning_there_and_back_changes_nothing():
    x, y = VECTOR[:, 0], VECTOR[:, 1]
    back = to_inertial(*to_body(x, y, PSI), PSI)
    torch.testing.assert_close(torch.stack(back), torch.stack([x, y]), rtol=0.0, atol=1e-13)
    there = to_body(*to_inertial(x, y, PSI), PSI)
    torch.testing.assert_close(torch.stack(there), torch.stack([x, y]), rtol=0.0, atol=1e-13)


def test_turns_are_complex_multiplication():
    """By e^(i psi) from body to inertial axes, by its conjugate from inertial to body."""
    for (x, y, *_), psi in zip(VECTOR.tolist(), PSI.tolist(), strict=True):
        turn = complex(math.cos(psi), math.sin(psi))
        tensors = (torch.tensor(value, dtype=torch.float64) for value in (x, y, psi))
        u, v = (float(part) for part in to_inertial(*tensors))
        assert complex(u, v) == pytest.approx(complex(x, y) * turn, abs=1e-13)


def test_rotation_matrix_turns_nu_into_the_rate_of_eta():
    J = rotation_matrix(PSI)
    x, y = to_inertial(VECTOR[:, 0], VECTOR[:, 1], PSI)
    expected = torch.stack([x, y, VECTOR[:, 2], VECTOR[:, 3]], -1)
    torch.testing.assert_close((J @ VECTOR[..., None])[..., 0], expected, rtol=0.0, atol=1e-13)
    body = torch.stack([*to_body(VECTOR[:, 0], VECTOR[:, 1], PSI), VECTOR[:, 2], VECTOR[:, 3]], -1)
    torch.testing.assert_close((J.mT @ VECTOR[..., None])[..., 0], body, rtol=0.0, atol=1e-13)
    torch.testing.assert_close(J @ J.mT, torch.eye(4).double().expand_as(J), rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("size", [2, 3, 4])
def test_whole_vectors_turn_alike(size: int):
    """What comes after the horizontal components stays; leading dimensions broadcast."""
    vector, psi = VECTOR[:1000, :size].view(10, 100, size), PSI[:1000].view(10, 100)
    turned = turned_to_inertial(vector, psi)
    J = rotation_matrix(psi)[..., :size, :size]
    torch.testing.assert_close(turned, (J @ vector[..., None])[..., 0], rtol=0.0, atol=1e-13)
    torch.testing.assert_close(turned_to_body(turned, psi), vector, rtol=0.0, atol=1e-13)
    assert torch.equal(turned[..., 2:], vector[..., 2:])


def test_body_axes_point_where_they_should():
    """At psi = 90 degrees surge points along y, and sway, to port, along -x."""
    quarter = torch.tensor(math.pi / 2, dtype=torch.float64)
    one, zero = torch.ones(()).double(), torch.zeros(()).double()
    assert [float(part) for part in to_inertial(one, zero, quarter)] == pytest.approx([0.0, 1.0], abs=1e-15)
    assert [float(part) for part in to_inertial(zero, one, quarter)] == pytest.approx([-1.0, 0.0], abs=1e-15)


def test_unit_vectors_and_their_left():
    ahead = unit_vector(PSI)
    torch.testing.assert_close(torch.atan2(ahead[:, 1], ahead[:, 0]), remainder(PSI), rtol=0.0, atol=1e-13)
    torch.testing.assert_close(left_of(ahead), unit_vector(PSI + math.pi / 2), rtol=0.0, atol=1e-13)
    assert bool((left_of(left_of(ahead)) == -ahead).all())


def remainder(angle: Tensor, period: float = 2.0 * math.pi) -> Tensor:
    return torch.tensor([math.remainder(value, period) for value in angle.tolist()], dtype=torch.float64)


@pytest.mark.parametrize("period", [2.0 * math.pi, math.pi, 1.0])
def test_wrapped_is_the_ieee_remainder(period: float):
    angle = uniform(COUNT, within=50.0, seed=2)
    found = wrapped(angle, period)
    torch.testing.assert_close(found, remainder(angle, period), rtol=0.0, atol=1e-13)
    assert bool(((found >= -period / 2) & (found < period / 2)).all())


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 7])
def test_whole_turns_do_not_matter(turns: int):
    angle = uniform(COUNT, within=3.0, seed=3)
    torch.testing.assert_close(wrapped(angle + turns * 2.0 * math.pi), angle, rtol=0.0, atol=1e-13)


def test_half_a_turn_is_minus_half_a_turn():
    assert wrapped(torch.tensor([0.5, -0.5, 1.5, 0.25]).double(), 1.0).tolist() == [-0.5, -0.5, -0.5, 0.25]


def test_distances_are_pythons():
    a, b = uniform(3, 7, 3, within=60.0), uniform(3, 5, 3, within=60.0, seed=1)
    expected = [[[math.dist(p, q) for q in qs] for p in ps] for ps, qs in zip(a.tolist(), b.tolist(), strict=True)]
    torch.testing.assert_close(distances(a, b), torch.tensor(expected, dtype=torch.float64), rtol=1e-14, atol=0.0)


def test_distances_are_exact():
    """A tenth of a micrometre, a kilometre from the origin, is not lost, and the diagonal is zero."""
    a = torch.tensor([[1000.0, -1000.0, -8.0], [1000.0, -1000.0, -8.0 + 1e-7]], dtype=torch.float64)
    D = distances(a, a)
    assert D.diagonal().tolist() == [0.0, 0.0]
    assert float(D[0, 1]) == pytest.approx(1e-7, rel=1e-6)
