"""The grid critic against closed forms of the eikonal equation, Dijkstra's distances and ways round obstacles."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor
from torch.utils._pytree import tree_leaves

from uwirl.irl.grid_critic import GridMap, solve_eikonal

ORIGIN = torch.tensor([-3.0, 2.0], dtype=torch.float64)


def _nodes(nx: int, ny: int, h: float) -> Tensor:
    """[nx, ny, 2]."""
    axes = [ORIGIN[i] + h * torch.arange(n, dtype=torch.float64) for i, n in enumerate((nx, ny))]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)


def _target(*offset: float) -> Tensor:
    return (ORIGIN + torch.tensor(offset, dtype=torch.float64))[None]


def _clutter(maps: int, nx: int = 41, ny: int = 33, h: float = 0.5) -> tuple[Tensor, Tensor]:
    """Slownesses [B, nx, ny] with costly discs that have a soft edge, and targets [B, 2] off the nodes."""
    generator = torch.Generator().manual_seed(5)
    p = _nodes(nx, ny, h)
    extent = h * torch.tensor([nx - 1, ny - 1], dtype=torch.float64)
    target = ORIGIN + extent * torch.rand(maps, 2, generator=generator, dtype=torch.float64)
    w = 0.2 + 0.01 * (p - target[:, None, None]).norm(dim=-1)
    for _ in range(6):
        centre = ORIGIN + extent * torch.rand(maps, 1, 1, 2, generator=generator, dtype=torch.float64)
        w = w + 2.0 * torch.sigmoid((2.5 - (p - centre).norm(dim=-1)) / 0.5)
    return w, target


def _cost_along(points: Tensor, w: Tensor, h: float) -> float:
    """Integral of the bilinear slowness w [nx, ny] along a polyline [K, 2]."""
    slowness = RegularGridInterpolator([ORIGIN[i].item() + h * np.arange(n) for i, n in enumerate(w.shape)], w.numpy())
    share = (np.arange(8) + 0.5) / 8.0
    return sum(
        float(slowness(a + share[:, None] * (b - a)).mean() * np.linalg.norm(b - a))
        for a, b in pairwise(points.numpy())
    )


def _order(errors: list[float]) -> list[float]:
    return [math.log2(coarse / fine) for coarse, fine in pairwise(errors)]


def test_uniform_slowness_gives_the_distance():
    """First order but for the logarithm that a point source costs: h log(1/h) gives orders that rise towards 1."""
    target = _target(7.3, 11.1)
    errors = []
    for h in (1.0, 0.5, 0.25):
        p = _nodes(round(20 / h) + 1, round(16 / h) + 1, h)
        found = solve_eikonal(torch.full_like(p[None, ..., 0], 2.0), ORIGIN, h, target)
        exact = 2.0 * (p - target[0]).norm(dim=-1)
        assert bool((found.value[0] >= exact - 1e-9).all())
        errors.append(float((found.value[0] - exact).abs().mean()))
    assert errors[-1] < 0.02 * float(exact.max())
    assert all(0.45 < order < 1.0 for order in _order(errors))


def test_linear_velocity_gives_the_closed_travel_time():
    """T = arccosh(1 + g^2 |x - x0|^2 / (2 v v0)) / g, v = v0 + g.(x - x0): the rays are arcs of circles."""
    target = _target(7.0, 11.0)
    g = torch.tensor([0.06, 0.08], dtype=torch.float64)
    errors = []
    for h in (1.0, 0.5, 0.25):
        p = _nodes(round(20 / h) + 1, round(16 / h) + 1, h)
        v = 2.0 + (p - target[0]) @ g
        found = solve_eikonal(1.0 / v[None], ORIGIN, h, target)
        square = ((p - target[0]) ** 2).sum(-1)
        exact = torch.acosh(1.0 + (g @ g) * square / (2.0 * v * 2.0)) / g.norm()
        errors.append(float((found.value[0] - exact).abs().max()))
    assert errors[-1] < 0.025 * float(exact.max())
    assert all(0.7 < order < 1.0 for order in _order(errors))


def test_batch_equals_singles():
    w, target = _clutter(5)
    batch = solve_eikonal(w, ORIGIN, 0.5, target)
    assert len(batch.rounds.unique()) > 1  # maps that are done wait for the others
    for i in range(5):
        single = solve_eikonal(w[i : i + 1], ORIGIN, 0.5, target[i : i + 1])
        assert torch.equal(single.value[0], batch.value[i])
        assert torch.equal(single.rounds[0], batch.rounds[i])


def test_value_lies_between_dijkstra_and_the_least_slowness():
    """Dijkstra's ways on the 8-neighbour grid are ways, if longer than the best by at most 8 %."""
    h = 0.25
    w, target = _clutter(3, 81, 65, h)
    nx, ny = w.shape[1:]
    target = ORIGIN + h * ((target - ORIGIN) / h).round()  # on a node, where Dijkstra starts
    found = solve_eikonal(w, ORIGIN, h, target)
    p = _nodes(nx, ny, h)
    index = np.arange(nx * ny).reshape(nx, ny)
    for i in range(3):
        cost = w[i].numpy()
        edges = []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            a = np.s_[: nx - dx, max(0, -dy) : ny - max(0, dy)]
            b = np.s_[dx:, max(0, dy) : ny + min(0, dy)]
            length = h * math.hypot(dx, dy) * (cost[a] + cost[b]) / 2.0
            edges.append((index[a].ravel(), index[b].ravel(), length.ravel()))
        start, end, length = (np.concatenate(x) for x in zip(*edges, strict=True))
        graph = coo_array((length, (start, end)), shape=(nx * ny, nx * ny)).tocsr()
        source = ((target[i] - ORIGIN) / h).round().long()
        bound = torch.from_numpy(dijkstra(graph, directed=False, indices=int(source[0] * ny + source[1])))
        bound = bound.reshape(nx, ny)
        # The scheme's own first-order error comes on top.
        assert bool((found.value[i] <= 1.05 * bound + h).all())
        assert bool((found.value[i] >= 0.92 * bound - h).all())
        assert bool((found.value[i] >= float(w[i].min()) * (p - target[i]).norm(dim=-1) - 1e-9).all())


def test_scaled_slowness_scales_the_value():
    w, target = _clutter(3)
    found, scaled = (solve_eikonal(factor * w, ORIGIN, 0.5, target) for factor in (1.0, 8.0))
    assert torch.equal(scaled.value, 8.0 * found.value)  # a power of two rounds nothing
    torch.testing.assert_close(scaled.descent, found.descent)


def test_mirrored_map_is_the_mirror_image():
    w, target = _clutter(2)
    mirrored = target.clone()
    mirrored[:, 0] = 2.0 * ORIGIN[0] + 20.0 - target[:, 0]
    found, mirror = solve_eikonal(w, ORIGIN, 0.5, target), solve_eikonal(w.flip(1), ORIGIN, 0.5, mirrored)
    torch.testing.assert_close(mirror.value.flip(1), found.value, rtol=1e-9, atol=1e-9)


def _wall(h: float = 0.25) -> tuple[Tensor, GridMap]:
    """A wall 1 m thick across 20 m x 16 m with a gap of 2 m at y = 12..14 m; the target behind it."""
    p = _nodes(round(20 / h) + 1, round(16 / h) + 1, h) - ORIGIN
    wall = ((p[..., 0] - 10.0).abs() <= 0.5) & ((p[..., 1] - 13.0).abs() >= 1.0)
    w = torch.where(wall, 20.0, 0.5)
    return w, solve_eikonal(w[None], ORIGIN, h, _target(16.0, 4.0))


def test_descent_passes_the_gap_in_a_wall():
    w, found = _wall()
    starts = ORIGIN + torch.tensor([[[3.0, 2.0], [6.0, 9.0], [1.0, 15.0]]], dtype=torch.float64)
    paths = found.path(starts)
    for points, value, start in zip(paths[0], found.value_at(starts)[0], starts[0], strict=True):
        assert float((points[-1] - found.target[0]).norm()) < 1e-3
        at_wall = points[((points[:, 0] - ORIGIN[0] - 10.0).abs() <= 0.5)] - ORIGIN
        assert len(at_wall) > 1
        assert bool(((at_wall[:, 1] - 13.0).abs() < 1.0).all())
        # The taut string round the gap's lower corners.
        corners = torch.tensor([[9.5, 12.0], [10.5, 12.0]], dtype=torch.float64) + ORIGIN
        taut = 0.5 * sum(float((a - b).norm()) for a, b in pairwise([start, *corners, found.target[0]]))
        assert taut <= float(value) <= 1.08 * taut  # the upwind scheme sees a wall one node thicker
        assert _cost_along(points, w, 0.25) == pytest.approx(float(value), rel=0.03)


def test_descent_leads_out_of_an_obstacle():
    """From anywhere in a disc that grows costlier inwards, by a way hardly longer than the radius."""
    h, radius = 0.5, 3.0
    p = _nodes(41, 33, h) - ORIGIN
    centre = torch.tensor([8.0, 8.0], dtype=torch.float64)
    depth = radius - (p - centre).norm(dim=-1)
    found = solve_eikonal(torch.where(depth > 0, 5.0 * (1.0 + 4.0 * depth), 0.5)[None], ORIGIN, h, _target(18.0, 8.0))
    inside = centre + torch.tensor([[0.3, 0.2], [-2.0, 1.0], [0.0, -2.5], [-1.0, 0.0], [2.0, 1.5]], dtype=torch.float64)
    points = found.path((inside + ORIGIN)[None])[0] - ORIGIN
    for way in points:
        depth = radius - (way - centre).norm(dim=-1)
        steps_inside = int((depth > 0.0).sum())
        assert steps_inside <= math.ceil(float(depth[0]) / 0.4) + 2
        assert bool((depth[steps_inside:] <= 0.0).all())
        assert float((way[-1] + ORIGIN - found.target[0]).norm()) < 1e-3


def test_descent_direction():
    _, found = _wall()
    target = found.target[0]
    near = target + torch.tensor([[1.0, 0.5], [-0.3, 0.1], [0.0, 0.0]], dtype=torch.float64)
    direction = found.descent_direction(near[None])[0]
    torch.testing.assert_close(direction[:2], (target - near[:2]) / (target - near[:2]).norm(dim=-1, keepdim=True))
    assert bool((direction[2] == 0.0).all())
    far = ORIGIN + torch.tensor([[[3.0, 2.0], [9.0, 11.0], [-4.0, 20.0]]], dtype=torch.float64)
    torch.testing.assert_close(found.descent_direction(far).norm(dim=-1), torch.ones(1, 3, dtype=torch.float64))
    assert float(found.descent_direction(far[:, :2])[0, :, 1].min()) > 0.5  # up, towards the gap
    lead_in = found.descent_direction(far)[0, 2]
    assert float(lead_in[0]) > 0.0 > float(lead_in[1])  # from outside, back onto the grid


def test_a_step_never_passes_the_target():
    _, found = _wall()
    start = found.target[:, None] + torch.tensor([1.3, 0.0], dtype=torch.float64)
    ahead = (found.path(start, step=0.4) - found.target[:, None, None])[0, 0, :, 0]
    torch.testing.assert_close(ahead, torch.tensor([1.3, 0.9, 0.5, 0.1, 0.0], dtype=torch.float64), rtol=0, atol=1e-12)


def test_a_step_and_its_interpolation_end_at_the_edge_whatever_the_spacing():
    """0.37 has no exact binary form: the far edge must be the last node's place in double precision."""
    w = torch.ones(1, 9, 7, dtype=torch.float64)
    found = solve_eikonal(w, ORIGIN, 0.37, _target(1.0, 1.0))
    far = (ORIGIN + torch.tensor([50.0, 40.0], dtype=torch.float64))[None, None]
    edge = found.path(far, max_steps=0)[0, 0, 0] - ORIGIN
    torch.testing.assert_close(edge, torch.tensor([8 * 0.37, 6 * 0.37], dtype=torch.float64), rtol=0, atol=1e-12)
    assert float(found.value_at(far)[0, 0]) == float(found.value[0, -1, -1])


def test_replaced_maps():
    """Of three maps the last and the first are replaced by two others; the three stay as they were."""
    w, target = _clutter(5)
    three, two = (solve_eikonal(w[rows], ORIGIN, 0.5, target[rows]) for rows in ([0, 1, 2], [3, 4]))
    before = [part.clone() for part in tree_leaves(three)]
    after = three.replaced(torch.tensor([2, 0]), two)
    assert all(torch.equal(a, b) for a, b in zip(tree_leaves(three), before, strict=True))
    expected = solve_eikonal(w[[4, 1, 3]], ORIGIN, 0.5, target[[4, 1, 3]])
    assert all(torch.equal(a, b) for a, b in zip(tree_leaves(after), tree_leaves(expected), strict=True))
    masked = three.replaced(torch.tensor([True, False, True]), two)
    assert torch.equal(masked.target, target[[3, 1, 4]])


def test_stacked_maps():
    w, target = _clutter(5)
    parts = [solve_eikonal(w[rows], ORIGIN, 0.5, target[rows]) for rows in ([0, 1], [2], [3, 4])]
    whole = solve_eikonal(w, ORIGIN, 0.5, target)
    assert all(torch.equal(a, b) for a, b in zip(tree_leaves(GridMap.stack(parts)), tree_leaves(whole), strict=True))


def test_single_precision():
    w, target = _clutter(2)
    found = solve_eikonal(w.float(), ORIGIN.float(), 0.5, target.float())
    assert found.value.dtype == torch.float32
    torch.testing.assert_close(found.value.double(), solve_eikonal(w, ORIGIN, 0.5, target).value, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.inf, math.nan])
def test_slowness_must_be_positive_and_finite(bad: float):
    w = torch.ones(1, 9, 9, dtype=torch.float64)
    w[0, 4, 4] = bad
    with pytest.raises(ValueError, match="positive and finite"):
        solve_eikonal(w, ORIGIN, 0.5, _target(1.0, 1.0))


@pytest.mark.parametrize("offset", [(-0.1, 1.0), (1.0, 4.1), (math.nan, 1.0)])
def test_target_outside_the_grid_is_refused(offset: tuple[float, float]):
    with pytest.raises(ValueError, match="target lies outside"):
        solve_eikonal(torch.ones(1, 9, 9, dtype=torch.float64), ORIGIN, 0.5, _target(*offset))


def test_grid_too_small_is_refused():
    with pytest.raises(ValueError, match="at least 3 nodes"):
        solve_eikonal(torch.ones(1, 2, 9, dtype=torch.float64), ORIGIN, 0.5, _target(0.1, 1.0))


def test_too_few_rounds_are_reported():
    w, target = _clutter(2)
    with pytest.raises(ArithmeticError, match="within 1 rounds"):
        solve_eikonal(w, ORIGIN, 0.5, target, max_rounds=1)
