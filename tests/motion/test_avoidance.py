"""The avoidance term: where it vanishes, where the printed one does not, and Remark 2."""

import math

import pytest
import torch

from uwirl.motion.avoidance import Printed, remark_2, smooth

INFLUENCE = torch.tensor(6.0, dtype=torch.float64)


def at(*distances: float) -> torch.Tensor:
    """One obstacle at each distance: [Q, 1]."""
    return torch.tensor(distances, dtype=torch.float64)[:, None]


def test_smooth_vanishes_at_the_influence_radius_and_beyond():
    expected = torch.tensor([(1 / 3 - 1 / 6) ** 2, (1 / 5.99 - 1 / 6) ** 2, 0.0, 0.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(smooth(at(3.0, 5.99, 6.0, 8.0, math.inf), INFLUENCE), expected)


def test_remark_2_goes_through_both_points():
    c, nu = remark_2(5.9, 6.5, 0.9, 0.1)
    for l, kappa in ((5.9, 0.9), (6.5, 0.1)):
        assert math.exp(-0.5 * (l**2 / nu**2) ** c) == pytest.approx(kappa, rel=1e-12)


@pytest.mark.parametrize("arguments", [(6.5, 5.9, 0.9, 0.1), (5.9, 6.5, 0.1, 0.9), (5.9, 6.5, 1.0, 0.1)])
def test_remark_2_refuses_points_out_of_order(arguments):
    with pytest.raises(ValueError, match="kappa_2 < kappa_1"):
        remark_2(*arguments)


def test_the_printed_constants_make_a_ring_that_attracts():
    """c = 10, nu = 10, rho_o = 6: the term is zero on the ring l = 6 m and grows again up to about 9 m."""
    printed = Printed(c=10.0, nu=10.0)
    l = torch.linspace(6.0, 9.0, 31, dtype=torch.float64)[:, None]
    assert float(printed(at(6.0), INFLUENCE)) == 0.0
    assert (printed(l, INFLUENCE).diff() > 0.0).all()


def test_remark_2_leaves_almost_nothing_of_the_ring():
    ring = torch.linspace(6.0, 12.0, 601, dtype=torch.float64)[:, None]
    largest = [
        float(Printed(*constants)(ring, INFLUENCE).max()) for constants in ((10.0, 10.0), remark_2(5.9, 6.5, 0.9, 0.1))
    ]
    assert largest[1] < 0.05 * largest[0]


def test_no_obstacle_costs_nothing():
    assert float(Printed(10.0, 10.0)(at(math.inf), INFLUENCE)) == float(smooth(at(math.inf), INFLUENCE)) == 0.0
