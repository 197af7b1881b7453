"""The grid critic in one and three dimensions and with a spacing for each axis, against closed forms and itself."""

import math
from itertools import pairwise

import pytest
import torch
from scipy.integrate import quad
from torch import Tensor
from torch.utils._pytree import tree_leaves

from uwirl.irl.grid_critic import solve_eikonal
from uwirl.irl.sweeps import BoxSweeps, SquareSweeps


def tensor(*entries: float) -> Tensor:
    return torch.tensor(entries, dtype=torch.float64)


def nodes(origin: Tensor, sides: tuple[int, ...], h: tuple[float, ...]) -> Tensor:
    """[*n, d]."""
    axes = [origin[i] + h[i] * torch.arange(n, dtype=torch.float64) for i, n in enumerate(sides)]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)


def orders(errors: list[float]) -> list[float]:
    return [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]


@pytest.mark.parametrize("target", [0.0, 1.7, 4.0])
def test_one_axis_is_an_integral(target: float):
    """Phi(x) is the integral of w between the target and x; first order in h."""
    origin, errors = tensor(-1.0), []
    for n in (101, 201, 401):
        h = 5.0 / (n - 1)
        x = nodes(origin, (n,), (h,))[:, 0]
        found = solve_eikonal((1.0 + x.sin() ** 2)[None], origin, h, tensor(target)[None])
        exact = tensor(*(abs(quad(lambda s: 1.0 + math.sin(s) ** 2, target, float(end))[0]) for end in x))
        errors.append(float((found.value[0] - exact).abs().max()))
        downhill = torch.where(x < target, 1.0, -1.0)[:, None]
        away = (x - target).abs() > 1.5 * h
        assert torch.equal(found.descent[0, away], downhill.double()[away])
    assert errors[-1] < 0.01 * float(exact.max())
    assert all(0.9 < order < 1.1 for order in orders(errors))
    path = found.path(tensor(-0.9, 3.9)[None, :, None], step=0.3)[0, :, -1, 0]
    torch.testing.assert_close(path, tensor(target, target), rtol=0, atol=1e-3)


def test_one_axis_adds_node_after_node():
    """Beyond two nodes from the target each node adds h w exactly."""
    w = tensor(3.0, 1.0, 2.0, 5.0, 0.5, 4.0, 1.5)
    found = solve_eikonal(w[None], tensor(10.0), 0.5, tensor(10.5)[None]).value[0]
    torch.testing.assert_close(found.diff()[3:], 0.5 * w[4:], rtol=1e-12, atol=0)


BOXES = pytest.mark.parametrize("h", [(1.0, 1.0, 1.0), (0.5, 1.0, 2.0)], ids=["cubes", "boxes"])


@BOXES
def test_three_axes_give_the_distance(h: tuple[float, ...]):
    """Never below it; the logarithm that a point source costs, h log(1/h), gives orders that rise towards 1."""
    origin, target, errors = tensor(-4.0, 0.0, 2.0), tensor(1.3, 4.1, 7.7), []
    for factor in (1, 2, 4):
        fine = tuple(x / factor for x in h)
        p = nodes(origin, tuple(round(8.0 / x) + 1 for x in fine), fine)
        found = solve_eikonal(torch.full_like(p[None, ..., 0], 2.0), origin, fine, target[None])
        exact = 2.0 * (p - target).norm(dim=-1)
        assert bool((found.value[0] >= exact - 1e-9).all())
        errors.append(float((found.value[0] - exact).abs().max()))
    first, second = orders(errors)
    assert 0.5 < first < second < 1.0
    assert errors[-1] < 0.06 * float(exact.max())
    far = (p - target).norm(dim=-1) > 3.0
    towards = torch.nn.functional.normalize(target - p, dim=-1)
    assert float((found.descent[0] * towards).sum(-1)[far].min()) > 0.9


@BOXES
def test_three_axes_converge_with_first_order(h: tuple[float, ...]):
    """Without the point source: Phi is given within 2 of it. T = arccosh(1 + g^2 |x - x0|^2 / (2 v v0)) / g in a
    medium of velocity v = v0 + g.(x - x0), where the rays are arcs of circles."""
    target, g, errors = tensor(3.0, 4.0, 3.5), tensor(0.06, 0.08, 0.05), []
    for factor in (1, 2, 4):
        fine = tuple(x / factor for x in h)
        p = nodes(tensor(0.0, 0.0, 0.0), tuple(round(8.0 / x) + 1 for x in fine), fine)
        v = 2.0 + (p - target) @ g
        square = ((p - target) ** 2).sum(-1)
        exact = torch.acosh(1.0 + (g @ g) * square / (2.0 * v * 2.0)) / g.norm()
        phi = torch.where(square <= 4.0, exact, 1e100)[..., None]
        sweeps = BoxSweeps(1.0 / v[..., None], fine, 1e100)
        for _ in range(4):
            phi = sweeps.round(phi)
        errors.append(float((phi[..., 0] - exact).abs().max()))
    assert all(0.95 < order < 1.2 for order in orders(errors))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_does_not_change_along_an_axis_is_the_problem_without_it(axis: int):
    """A line of targets among boxes, which starts from what the plane holds around its target."""
    generator = torch.Generator().manual_seed(0)
    plane = 0.2 + torch.rand(15, 12, generator=generator, dtype=torch.float64)
    h, target = [0.5, 0.8], tensor(3.0, 4.0)
    value = solve_eikonal(plane[None], tensor(0.0, 0.0), h, target[None], tolerance=1e-12).value[0]
    around = ((nodes(tensor(0.0, 0.0), (15, 12), (0.5, 0.8)) - target) / tensor(*h)).norm(dim=-1) <= 2.0
    w, expected, start = (
        x.unsqueeze(axis).repeat_interleave(5, axis)[..., None]
        for x in (plane, value, torch.where(around, value, 1e100))
    )
    sweeps, phi = BoxSweeps(w, [*h[:axis], 3.0, *h[axis:]], 1e100), start
    for _ in range(10):
        phi = sweeps.round(phi)
    torch.testing.assert_close(phi, expected, rtol=1e-10, atol=0)


def clutter(sides: tuple[int, ...], maps: int) -> Tensor:
    """Random slownesses with walls three nodes thick, [B, *n]."""
    generator = torch.Generator().manual_seed(4)
    w = 0.1 + torch.rand(maps, *sides, generator=generator, dtype=torch.float64)
    w[:, 6:9, : sides[1] // 2] += 20.0
    w[1:, 14:17, sides[1] // 3 :] += 20.0
    return w


def test_both_kinds_of_sweeps_agree():
    """The general scheme on squares is the fast one's, round by round."""
    w, h, large = clutter((23, 19), 3).movedim(0, -1), 0.4, 1e100
    phi = torch.full_like(w, large)
    phi[3, 4, 0] = phi[20, 2, 1] = phi[10, 17, 2] = 0.0
    square, cube = SquareSweeps(w * h, large), BoxSweeps(w, (h, h), large)
    fast, general = phi, phi
    for _ in range(6):
        fast, general = square.round(fast), cube.round(general)
        torch.testing.assert_close(general, fast, rtol=1e-12, atol=0)


def test_another_unit_of_length_scales_the_value():
    w, target = clutter((23, 19), 3), tensor(4.1, 3.3).expand(3, 2)
    for h in ((0.5, 0.5), (0.5, 0.7)):
        one = solve_eikonal(w, tensor(0.0, 0.0), h, target)
        other = solve_eikonal(w, tensor(0.0, 0.0), [3.0 * x for x in h], 3.0 * target)
        torch.testing.assert_close(other.value, 3.0 * one.value, rtol=1e-12, atol=0)
        torch.testing.assert_close(other.descent, one.descent)


def test_a_diagonal_metric_is_a_matter_of_scaled_axes():
    """|grad Phi|_(R^-1) = w with constant w and R = diag(4, 1/4): Phi = w sqrt(dx'R dx) and the way there is straight,
    along R^-1 grad Phi, although the grid of squares in x has become one of boxes, 4 to 1."""
    root, target, errors = tensor(2.0, 0.5), tensor(5.2, 7.1), []
    for n in (21, 41, 81):
        h = 10.0 / (n - 1)
        x = nodes(tensor(0.0, 0.0), (n, n), (h, h))
        found = solve_eikonal(
            torch.full((1, n, n), 0.7, dtype=torch.float64), tensor(0.0, 0.0), h * root, (root * target)[None]
        )
        exact = 0.7 * ((x - target) * root).norm(dim=-1)
        assert bool((found.value[0] >= exact - 1e-9).all())
        errors.append(float((found.value[0] - exact).abs().max()))
    first, second = orders(errors)
    assert 0.4 < first < second < 1.0
    start = tensor(1.0, 2.0)
    way = found.path((root * start)[None, None], step=0.2)[0, 0] / root
    across = (way - target) @ torch.nn.functional.normalize(tensor(-1, 1) * (target - start).flip(0), dim=0)
    assert float(across.abs().max()) < 0.35
    assert float((way[-1] - target).norm()) < 1e-3


def test_stretched_axes_equal_finer_squares():
    """Grids of boxes and of squares of one continuous problem differ by their errors, which fall with h."""
    target, differences = tensor(5.3, 3.1), []

    def value(h: tuple[float, float]) -> Tensor:
        sides = round(12.0 / h[0]) + 1, round(8.0 / h[1]) + 1
        p = nodes(tensor(0.0, 0.0), sides, h)
        w = 0.5 + torch.exp(-((p - tensor(8.0, 4.0)) ** 2).sum(-1))
        found = solve_eikonal(w[None], tensor(0.0, 0.0), h, target[None])
        return found.value_at(nodes(tensor(0.0, 0.0), (13, 9), (1.0, 1.0)).flatten(0, 1)[None])[0]

    finest = value((0.05, 0.05))
    differences = [float((value((h, h / 2.0)) - finest).abs().max()) for h in (0.5, 0.25)]
    assert differences[0] < 0.06 * float(finest.max())
    assert differences[1] < 0.7 * differences[0]


def test_turned_and_mirrored_axes_are_the_same_problem():
    w, h, target = clutter((13, 9, 7), 2), (0.5, 0.7, 1.1), tensor(2.2, 3.0, 4.0).expand(2, 3)
    found = solve_eikonal(w, tensor(0.0, 0.0, 0.0), h, target)
    turned = solve_eikonal(w.permute(0, 3, 1, 2), tensor(0.0, 0.0, 0.0), (1.1, 0.5, 0.7), target[:, [2, 0, 1]])
    torch.testing.assert_close(turned.value.permute(0, 2, 3, 1), found.value, rtol=1e-9, atol=0)
    mirrored = solve_eikonal(w.flip(2), tensor(0.0, 0.0, 0.0), h, target * tensor(1, -1, 1) + tensor(0.0, 5.6, 0.0))
    torch.testing.assert_close(mirrored.value.flip(2), found.value, rtol=1e-9, atol=0)


def test_batch_equals_singles():
    w, h = clutter((19, 9, 7), 3), (0.5, 0.7, 1.1)
    target = tensor(2.2, 3.0, 4.0) + torch.arange(3)[:, None] * tensor(1.0, 0.4, 0.3)
    batch = solve_eikonal(w, tensor(0.0, 0.0, 0.0), h, target)
    for i in range(3):
        single = solve_eikonal(w[i : i + 1], tensor(0.0, 0.0, 0.0), h, target[i : i + 1])
        assert torch.equal(single.value[0], batch.value[i])
        assert torch.equal(single.rounds[0], batch.rounds[i])


def test_descent_goes_through_a_hole_in_a_wall():
    """In three dimensions the way leads through a hole 2 by 2 across and costs about what the taut string does."""
    h = 0.5
    p = nodes(tensor(0.0, 0.0, 0.0), (25, 21, 17), (h, h, h))
    hole = ((p[..., 1] - 8.0).abs() <= 1.0) & ((p[..., 2] - 6.0).abs() <= 1.0)
    w = torch.where(((p[..., 0] - 6.0).abs() <= 0.5) & ~hole, 20.0, 0.5)
    found = solve_eikonal(w[None], tensor(0.0, 0.0, 0.0), h, tensor(10.0, 2.0, 2.0)[None])
    start = tensor(1.0, 2.0, 2.0)
    points = found.path(start[None, None])[0, 0]
    assert float((points[-1] - found.target[0]).norm()) < 1e-3
    at_wall = points[(points[:, 0] - 6.0).abs() <= 0.5]
    assert len(at_wall) > 1
    assert bool(((at_wall[:, 1:] - tensor(8.0, 6.0)).abs() < 1.2).all())
    edge = tensor(6.0, 7.0, 5.0)
    taut = 0.5 * float((start - edge).norm() + (edge - found.target[0]).norm())
    value = float(found.value_at(start[None, None])[0, 0])
    assert 0.98 * taut <= value <= 1.2 * taut


def test_spacing_may_be_a_number_a_sequence_or_a_tensor():
    w, origin, target = clutter((23, 19), 2), tensor(0.0, 0.0), tensor(4.1, 3.3).expand(2, 2)
    one, *others = (solve_eikonal(w, origin, h, target) for h in (0.5, [0.5, 0.5], tensor(0.5, 0.5), tensor(0.5)[0]))
    assert torch.equal(one.lattice.spacing, tensor(0.5, 0.5))
    for other in others:
        assert all(torch.equal(a, b) for a, b in zip(tree_leaves(one), tree_leaves(other), strict=True))


@pytest.mark.parametrize("bad", [0.0, -0.5, math.inf, math.nan, (0.5, 0.0), (0.5, 0.5, 0.5)])
def test_impossible_spacings_are_refused(bad: float | tuple[float, ...]):
    with pytest.raises(ValueError, match="spacing must be positive and finite"):
        solve_eikonal(torch.ones(1, 9, 9, dtype=torch.float64), tensor(0.0, 0.0), bad, tensor(1.0, 1.0)[None])


@pytest.mark.parametrize("shape", [(1,), (1, 2), (1, 9, 9, 2), (1, 3, 3, 3, 3)])
def test_impossible_grids_are_refused(shape: tuple[int, ...]):
    axes = len(shape) - 1
    with pytest.raises(ValueError, match="1 to 3 axes of at least 3 nodes"):
        solve_eikonal(torch.ones(shape), torch.zeros(axes), 1.0, torch.ones(1, axes))
