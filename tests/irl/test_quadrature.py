"""Window integrals against closed forms."""

import math

import pytest
import torch

from uwirl.irl.quadrature import drop, held_product, simpson

DT = 0.05


def test_simpson_is_exact_for_cubics():
    t = torch.arange(21, dtype=torch.float64) * DT
    windows = simpson(t**3, DT, steps=10, stride=5)
    starts = torch.tensor([0.0, 0.25, 0.5], dtype=torch.float64)
    torch.testing.assert_close(windows, ((starts + 0.5) ** 4 - starts**4) / 4.0, rtol=0, atol=1e-15)


def test_simpson_converges_with_fourth_order():
    def error(steps: int) -> float:
        t = torch.linspace(0.0, 1.0, steps + 1, dtype=torch.float64)
        return abs(float(simpson(torch.exp(t), 1.0 / steps, steps, 1)[0]) - (math.e - 1.0))

    assert error(8) / error(16) == pytest.approx(16.0, rel=0.02)


def test_odd_number_of_steps_is_refused():
    with pytest.raises(ValueError, match="even number of steps"):
        simpson(torch.zeros(8), DT, steps=5, stride=1)


def test_window_longer_than_samples_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        simpson(torch.zeros(8), DT, steps=10, stride=1)


def test_held_product_integrates_a_jumping_control():
    """A control that jumps at each node times sin t: the exact integral is a sum of cosines."""
    generator = torch.Generator().manual_seed(0)
    t = torch.arange(11, dtype=torch.float64) * DT
    tau = torch.randn(10, generator=generator, dtype=torch.float64)
    exact = (tau * (torch.cos(t[:-1]) - torch.cos(t[1:]))).sum()
    found = held_product(torch.sin(t)[:, None], tau[:, None], DT, 10, 5)[0, 0]
    # The trapezoid's error is dt^2/12 of the integrand; Simpson over node products is off by a hundred times more.
    assert abs(float(found - exact)) < 3e-4 * abs(float(exact))
    nodes = torch.cat([tau, tau[-1:]])
    assert abs(float(simpson(torch.sin(t) * nodes, DT, 10, 5)[0] - exact)) > 1e-2 * abs(float(exact))


def test_drop_is_start_minus_end():
    phi = torch.arange(16.0)[:, None]
    torch.testing.assert_close(drop(phi, steps=10, stride=5), torch.tensor([[-10.0], [-10.0]]))
