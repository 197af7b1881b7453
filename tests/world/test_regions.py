"""Separation by discs: against a flood fill, against figures whose answer is known, and its symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from uwirl.world import regions
from uwirl.world.obstacles import Obstacles, no_obstacles
from uwirl.world.regions import separated

HALF_WIDTH = 5.5
CELL = 0.05


def discs(centre: Tensor, radius: Tensor, present: Tensor | None = None) -> Obstacles:
    present = torch.ones_like(radius, dtype=torch.bool) if present is None else present
    return Obstacles(centre, radius, radius + 4.0, torch.zeros_like(centre), present)


def ring(count: int, arc: float, overlap: float = 1.1, middle: tuple[float, float] = (0.0, 0.0)) -> Obstacles:
    """A closed ring; without its last discs it has a gap."""
    bearing = torch.arange(count, dtype=torch.float64) * (2.0 * math.pi / count)
    centre = torch.tensor(middle, dtype=torch.float64) + arc * torch.stack([bearing.cos(), bearing.sin()], -1)
    return discs(centre, torch.full((count,), overlap * arc * math.sin(math.pi / count), dtype=torch.float64))


def together(*parts: Obstacles) -> Obstacles:
    return discs(torch.cat([part.centre for part in parts]), torch.cat([part.radius for part in parts]))


def at(x: float, y: float) -> Tensor:
    return torch.tensor([x, y], dtype=torch.float64)


def random_discs(worlds: int, count: int, seed: int) -> tuple[Obstacles, Tensor, Tensor]:
    """A ragged ring of 14 discs, and `count` scattered ones; two points outside them when inflated by 0.2 m."""
    generator = torch.Generator().manual_seed(seed)

    def between(low: float, high: float, *shape: int) -> Tensor:
        return low + (high - low) * torch.rand(worlds, *shape, dtype=torch.float64, generator=generator)

    bearing = (torch.arange(14) + between(-0.2, 0.2, 14)) * (2.0 * math.pi / 14)
    arc, middle = between(2.2, 2.8, 14, 1), between(-1.0, 1.0, 1, 2)
    around = middle + arc * torch.stack([bearing.cos(), bearing.sin()], -1)
    centre = torch.cat([around, between(-4.0, 4.0, count, 2)], 1)
    obstacles = discs(centre, between(0.4, 0.8, 14 + count), between(0.0, 1.0, 14 + count) < 0.98)
    places = torch.cat([middle + between(-1.0, 1.0, 400, 2), between(-4.0, 4.0, 400, 2)], 1)
    free = obstacles.clearance(torch.nn.functional.pad(places, (0, 1)), 0.2).amin(-1) > 0.0
    first = free.view(worlds, 2, 400).to(torch.int8).max(-1).indices + torch.tensor([0, 400])
    assert bool(free.gather(1, first).all())
    p, q = places.gather(1, first[..., None].expand(-1, -1, 2)).unbind(1)
    return obstacles, p, q


def flood_fill(obstacles: Obstacles, inflations: tuple[float, ...], p: Tensor, q: Tensor) -> Tensor:
    """Whether p and q lie in two parts of the grid's free cells, or not in any, for each inflation and world."""
    axis = np.arange(-HALF_WIDTH, HALF_WIDTH + CELL / 2, CELL)
    answers = []
    for world in range(len(p)):
        gap = np.full((len(axis), len(axis)), np.inf)
        for i in obstacles.present[world].nonzero()[:, 0]:
            x, y = obstacles.centre[world, i].tolist()
            distance = np.sqrt(((axis - x) ** 2)[:, None] + (axis - y) ** 2)
            np.minimum(gap, distance - float(obstacles.radius[world, i]), out=gap)
        cells = [tuple(np.rint((point[world].numpy() + HALF_WIDTH) / CELL).astype(int)) for point in (p, q)]
        labels = [ndimage.label(gap >= inflation)[0] for inflation in inflations]
        answers.append([label[cells[0]] != label[cells[1]] or label[cells[0]] == 0 for label in labels])
    return torch.tensor(answers).T


def test_flood_fill_agrees():
    """A way with clearance CELL is a way on the grid, and a way on the grid is one between discs CELL smaller.

    Where the fill gives one answer for discs CELL larger and CELL smaller, that is therefore the exact one. The others,
    about 30 in 100 of these crowded layouts, are left out.
    """
    for count, seed in ((0, 0), (5, 1), (10, 2), (15, 3)):
        obstacles, p, q = random_discs(125, count, seed)
        smaller, larger = flood_fill(obstacles, (0.2 - CELL, 0.2 + CELL), p, q)
        certain = smaller == larger
        assert 0.6 < certain.double().mean()
        assert 0.3 < larger[certain].double().mean() < 0.8
        assert torch.equal(separated(obstacles, 0.2, p, q)[certain], larger[certain])


def test_free_water():
    assert not bool(separated(no_obstacles(), 0.3, at(0.0, 0.0), at(1.0, 0.0)))
    assert separated(no_obstacles(), 0.3, torch.zeros(4, 1, 2), torch.zeros(3, 2)).shape == (4, 3)


def test_one_disc_cuts_nothing_off():
    assert not bool(separated(discs(at(0.0, 0.0)[None], at(1.0, 0.0)[:1]), 0.3, at(-2.0, 0.0), at(2.0, 0.0)))


def test_closed_ring():
    closed = ring(24, 5.0)
    assert bool(separated(closed, 0.0, at(0.0, 0.0), at(20.0, 3.0)))
    assert not bool(separated(closed, 0.0, at(0.0, 0.0), at(1.0, -2.0)))
    assert not bool(separated(closed, 0.0, at(-9.0, 0.1), at(20.0, 3.0)))


def test_ring_with_a_gap_closes_with_inflation():
    """The gap between the surfaces of two discs, less twice the inflation, is what is left to go through."""
    whole = ring(24, 5.0)
    open_ring = discs(whole.centre[:-1], whole.radius[:-1])
    gap = float(torch.linalg.vector_norm(whole.centre[0] - whole.centre[-2]) - 2.0 * whole.radius[0])
    for inflation, closed in ((0.0, False), (gap / 2 - 1e-9, False), (gap / 2 + 1e-9, True)):
        assert bool(separated(open_ring, inflation, at(0.0, 0.0), at(20.0, 3.0))) == closed


def test_absent_discs_leave_a_gap():
    closed = ring(24, 5.0)
    present = torch.arange(24) != 7
    assert not bool(separated(discs(closed.centre, closed.radius, present), 0.0, at(0.0, 0.0), at(20.0, 3.0)))


def test_dead_end_is_no_separation():
    whole = ring(12, 4.0)
    u = discs(whole.centre[:8], whole.radius[:8])
    assert not bool(separated(u, 0.0, at(0.0, 0.0), at(0.5, 12.0)))


def test_nested_rings():
    nested = together(ring(16, 3.0), ring(24, 6.0))
    assert bool(separated(nested, 0.0, at(0.0, 0.0), at(4.5, 0.0)))
    assert bool(separated(nested, 0.0, at(4.5, 0.0), at(9.0, 0.0)))
    assert bool(separated(nested, 0.0, at(0.0, 0.0), at(9.0, 0.0)))
    assert not bool(separated(nested, 0.0, at(4.5, 0.0), at(-4.5, 0.1)))


def test_a_ring_each():
    rings = together(ring(16, 3.0), ring(16, 3.0, middle=(10.0, 0.0)))
    assert bool(separated(rings, 0.0, at(0.0, 0.0), at(10.0, 0.0)))


def test_rings_that_share_discs():
    """The lens of two crossing rings is cut off from either crescent, and the crescents from each other."""
    rings = together(ring(32, 5.0), ring(32, 5.0, middle=(5.0, 0.3)))
    places = [at(2.5, 0.0), at(-2.5, 0.0), at(7.5, 0.0), at(2.5, 9.0)]
    for i, p in enumerate(places):
        for j, q in enumerate(places):
            assert bool(separated(rings, 0.0, p, q)) == (i != j)


@pytest.mark.parametrize("count", [4, 8, 24])
def test_centres_on_the_line_between_the_points(count):
    """The segment runs exactly through the middle of a disc, through two, or along a row of them."""
    for q in (at(20.0, 0.0), at(0.0, 20.0), at(-20.0, 0.0)):
        assert bool(separated(ring(count, 5.0), 0.0, at(0.0, 0.0), q))
        assert not bool(separated(ring(count, 5.0), 0.0, -q, q))
    row = discs(torch.stack([torch.linspace(-3, 3, 7), torch.zeros(7)], -1).double(), torch.full((7,), 0.6).double())
    assert not bool(separated(row, 0.0, at(-5.0, 0.0), at(5.0, 0.0)))


def test_inside_a_disc_there_is_no_way():
    one = discs(at(0.0, 0.0)[None], at(1.0, 0.0)[:1])
    inside, outside = at(1.2, 0.0), at(3.0, 0.0)
    assert bool(separated(one, 0.3, inside, outside))
    assert bool(separated(one, 0.3, outside, inside))
    assert bool(separated(one, 0.3, inside, inside))
    assert not bool(separated(one, 0.1, inside, outside))


def test_either_way_is_the_same():
    obstacles, p, q = random_discs(400, 10, 4)
    assert torch.equal(separated(obstacles, 0.2, p, q), separated(obstacles, 0.2, q, p))


def test_rigid_motion_and_order_change_nothing():
    obstacles, p, q = random_discs(400, 10, 5)
    c, s = math.cos(0.7), math.sin(0.7)
    turn = torch.tensor([[c, -s], [s, c]], dtype=torch.float64)
    order = torch.randperm(24, generator=torch.Generator().manual_seed(0))

    def moved(points: Tensor) -> Tensor:
        return points @ turn.T + at(3.0, -40.0)

    other = discs(moved(obstacles.centre)[:, order], obstacles.radius[:, order], obstacles.present[:, order])
    assert torch.equal(separated(obstacles, 0.2, p, q), separated(other, 0.2, moved(p), moved(q)))


def test_blocks_and_batches_equal_singles(monkeypatch):
    obstacles, p, q = random_discs(60, 10, 6)
    together = separated(obstacles, 0.2, p, q)
    fields = obstacles.centre, obstacles.radius, obstacles.present
    singles = [separated(discs(*(field[i] for field in fields)), 0.2, p[i], q[i]) for i in range(60)]
    assert torch.equal(together, torch.stack(singles))
    monkeypatch.setattr(regions, "BLOCK", 7 * 24**2)
    assert torch.equal(together, separated(obstacles, 0.2, p, q))


def test_many_points_among_the_same_discs(monkeypatch):
    same = ring(24, 3.0)
    every = discs(same.centre.expand(50, 24, 2), same.radius.expand(50, 24))
    x = torch.linspace(0.05, 6.0, 50, dtype=torch.float64)
    p, q = torch.stack([x, torch.zeros_like(x)], -1), at(0.0, 0.1)
    expected = x > 3.0 - same.radius[0]
    assert torch.equal(separated(every, 0.0, p, q), expected)
    assert torch.equal(separated(same, 0.0, p, q), expected)
    monkeypatch.setattr(regions, "BLOCK", 7 * 24**2)
    assert torch.equal(separated(same, 0.0, p, q), expected)


def test_points_of_several_vehicles_in_each_world():
    obstacles, p, q = random_discs(40, 10, 8)
    each = discs(obstacles.centre[:, None], obstacles.radius[:, None], obstacles.present[:, None])
    pairs = separated(each, 0.2, torch.stack([p, q], 1), q[0])
    assert pairs.shape == (40, 2)
    assert torch.equal(pairs[:, 1], separated(obstacles, 0.2, q, q[0].expand(40, 2)))
