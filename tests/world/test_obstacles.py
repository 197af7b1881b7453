"""Cylinders: clearances by hand, masks, drift and contacts."""

import math

import pytest
import torch

from uwirl.world.obstacles import Obstacles, contacts, no_obstacles


def cylinders(centre, radius, velocity=None, present=None) -> Obstacles:
    centre, radius = torch.tensor(centre, dtype=torch.float64), torch.tensor(radius, dtype=torch.float64)
    return Obstacles(
        centre,
        radius,
        radius + 4.0,
        torch.zeros_like(centre) if velocity is None else torch.tensor(velocity, dtype=torch.float64),
        torch.ones_like(radius, dtype=torch.bool) if present is None else torch.tensor(present),
    )


def at(*points) -> torch.Tensor:
    """One world, one vehicle a point: [M, 3]."""
    return torch.tensor(points, dtype=torch.float64)


def test_clearance_by_hand():
    gap = cylinders([[3.0, 4.0], [-2.0, 0.0]], [2.0, 0.5]).clearance(at((0.0, 0.0, -3.0), (3.0, 4.0, 0.0)), 0.3)
    expected = [[5.0 - 2.3, 2.0 - 0.8], [-2.3, math.hypot(5.0, 4.0) - 0.8]]
    torch.testing.assert_close(gap, torch.tensor(expected, dtype=torch.float64))


def test_depth_does_not_matter():
    obstacles = cylinders([[1.0, 1.0]], [0.5])
    torch.testing.assert_close(
        obstacles.clearance(at((4.0, 4.0, -20.0)), 0.3), obstacles.clearance(at((4.0, 4.0, 0.0)), 0.3)
    )


def test_absent_cylinders_are_infinitely_far():
    some = cylinders([[1.0, 0.0], [0.5, 0.5]], [0.5, 0.2], present=[True, False])
    one = cylinders([[1.0, 0.0]], [0.5])
    p = at((0.0, 0.0, 0.0))
    torch.testing.assert_close(some.clearance(p, 0.3).amin(-1), one.clearance(p, 0.3).amin(-1))
    assert some.distance(p)[0].tolist() == [1.0, math.inf]


def test_worlds_with_other_obstacles():
    """A leading batch of worlds: each sees its own."""
    obstacles = cylinders([[[3.0, 0.0]], [[0.0, 7.0]]], [[1.0], [2.0]])
    gap = obstacles.clearance(torch.zeros(2, 1, 3, dtype=torch.float64), 0.3)
    torch.testing.assert_close(gap[:, 0, 0], torch.tensor([1.7, 4.7], dtype=torch.float64))


def test_drifting_cylinder_meets_a_resting_vehicle():
    obstacles = cylinders([[10.0, 0.0]], [1.0], velocity=[[-0.5, 0.0]])
    time = torch.arange(0.0, 40.0, 0.5, dtype=torch.float64)
    gap = obstacles.clearance(torch.zeros(len(time), 1, 3, dtype=torch.float64), 0.3, time)
    torch.testing.assert_close(gap[:, 0, 0], (10.0 - 0.5 * time).abs() - 1.3)
    assert contacts(gap[:, 0].amin(-1)) == 1


@pytest.mark.parametrize(
    ("clearance", "count"),
    [([1.0, -1.0, -2.0, 1.0, -1.0], 2), ([-1.0, -1.0, 1.0], 1), ([1.0, 0.0, 1.0], 0), ([-1.0], 1)],
)
def test_contacts_are_intervals(clearance, count):
    assert contacts(torch.tensor(clearance)) == count


def test_free_water():
    free = no_obstacles()
    p = at((1.0, 2.0, 3.0))
    assert free.clearance(p, 0.3).shape == (1, 0)


def test_worlds_of_a_batch():
    obstacles = cylinders([[[3.0, 0.0]], [[0.0, 7.0]]], [[1.0], [2.0]])
    second = obstacles.worlds(torch.tensor([1]))
    assert second.centre.tolist() == [[[0.0, 7.0]]]
    shared = cylinders([[3.0, 0.0]], [1.0])
    assert shared.worlds(torch.tensor([1])) is shared
