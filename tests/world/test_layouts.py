"""Random layouts: the rules they are drawn by, what each kind is, and independence of the batch."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from uwirl.world import layouts as layouts_module
from uwirl.world.layouts import KINDS, Layouts, draw_layouts
from uwirl.world.random import RandomStreams

N = 200
RADIUS = 0.3
# A vehicle and a margin: less than half the narrowest gap of a ring.
INFLATION = 0.4
ONE = torch.tensor([[0.0, 0.0, -8.0]], dtype=torch.float64)
THREE = torch.tensor([[-12.0, -11.0, -8.0], [0.0, 1.0, -8.0], [12.0, 10.0, -8.0]], dtype=torch.float64)


def draw(kinds, targets: Tensor = ONE, count: int = N, seed: int = 1) -> Layouts:
    return draw_layouts(RandomStreams.worlds(seed, count), kinds, targets)


def tensors(layouts: Layouts) -> dict[str, Tensor]:
    return layouts.obstacles._asdict() | {"start": layouts.start, "kind": layouts.kind}


def spacing(layouts: Layouts) -> Tensor:
    """Between the surfaces of each cylinder and the next, the last and the first, [N, O], m."""
    centre, radius = layouts.obstacles.centre, layouts.obstacles.radius
    apart = torch.linalg.vector_norm(centre - centre.roll(-1, 1), dim=-1)
    return apart - radius - radius.roll(-1, 1)


@pytest.mark.parametrize("targets", [ONE, THREE], ids=["one", "three"])
@pytest.mark.parametrize("kind", KINDS)
def test_rules(kind, targets):
    layouts = draw([kind], targets)
    position, gap = layouts.start[..., :3], layouts.obstacles.clearance
    assert layouts.start.shape == (N, len(targets), 4)
    assert float(gap(position, RADIUS).min()) >= (1.5 if kind == "moving" else 0.6)
    assert float(gap(targets, RADIUS).min()) >= 1.2
    assert float(torch.linalg.vector_norm(position[..., :2] - targets[:, :2], dim=-1).min()) >= 12.0
    apart = torch.cdist(position, position) + 99.0 * torch.eye(len(targets))
    assert float(apart.min()) >= 2.0
    assert bool(((position[..., 2] >= -16.0) & (position[..., 2] <= -0.5)).all())
    assert float(layouts.start[..., 3].abs().max()) <= 2.0
    assert float((position[..., :2] - targets[:, :2].mean(0)).abs().max()) <= 30.0


@pytest.mark.parametrize("targets", [ONE, THREE], ids=["one", "three"])
def test_no_target_is_run_over(targets):
    obstacles = draw(["moving"], targets).obstacles
    gaps = [obstacles.clearance(targets, RADIUS, time).amin() for time in torch.linspace(0.0, 120.0, 601)]
    assert 0.8 <= min(float(gap) for gap in gaps) < 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_count_and_speed(kind):
    fewest, most = {"sparse": (0, 3), "random": (3, 6), "overlapping": (2, 6), "dead_end": (6, 6)}.get(kind, (1, 4))
    if kind == "ring":
        fewest = most = 24
    obstacles = draw([kind]).obstacles
    count = obstacles.present.sum(-1)
    assert (int(count.min()), int(count.max()), obstacles.number) == (fewest, most, most)
    speed = torch.linalg.vector_norm(obstacles.velocity, dim=-1)[obstacles.present]
    low, high = (0.2, 0.5) if kind == "moving" else (0.0, 0.0)
    assert bool(((speed >= low - 1e-12) & (speed <= high + 1e-12)).all())


def test_kinds_take_turns():
    kinds = ("ring", "sparse", "moving")
    layouts = draw(kinds, count=8)
    assert [KINDS[i] for i in layouts.kind] == [kinds[world % 3] for world in range(8)]
    count = layouts.obstacles.present.sum(-1)
    assert count[::3].tolist() == [24, 24, 24]
    assert int(count[1::3].max()) <= 3


def test_absent_cylinders_are_out_of_the_way():
    obstacles = draw(KINDS).obstacles
    absent = ~obstacles.present
    assert bool((obstacles.centre[absent] == 1e4).all())
    assert bool((obstacles.velocity[absent] == 0.0).all())
    assert torch.unique(obstacles.radius[absent]).tolist() == [1.0]
    assert torch.unique(obstacles.influence[absent]).tolist() == [2.0]
    torch.testing.assert_close(obstacles.influence[~absent], obstacles.radius[~absent] + 4.0)


def test_world_is_the_same_in_any_batch():
    many = tensors(draw(KINDS, THREE, 60))
    few = tensors(draw(KINDS, THREE, 7))
    alone = tensors(draw_layouts(RandomStreams(torch.tensor([1]), torch.tensor([44])), KINDS, THREE))
    for name, tensor in many.items():
        assert torch.equal(tensor[:7], few[name])
        assert torch.equal(tensor[44:45], alone[name])


def test_world_is_the_same_beside_other_kinds():
    among, only = draw(("ring", "sparse"), count=20), draw(("sparse",), count=20)
    assert torch.equal(among.start[1::2], only.start[1::2])
    assert torch.equal(among.obstacles.centre[1::2, :3], only.obstacles.centre[1::2])


def test_other_seeds_give_other_layouts():
    starts = torch.cat([draw(["random"], count=50, seed=seed).start[:, 0, 0] for seed in (1, 2)])
    assert len(starts.unique()) == 100


def test_layouts_move_with_their_targets():
    shift = torch.tensor([7.0, -30.0, 0.0], dtype=torch.float64)
    here, there = draw(["random", "dead_end"], THREE), draw(["random", "dead_end"], THREE + shift)
    torch.testing.assert_close(there.start[..., :3], here.start[..., :3] + shift)
    present = here.obstacles.present
    torch.testing.assert_close(there.obstacles.centre[present], here.obstacles.centre[present] + shift[:2])


def test_precision_is_that_of_the_targets():
    narrow = draw(KINDS, ONE.float(), 24)
    assert {narrow.start.dtype, narrow.obstacles.centre.dtype, narrow.obstacles.influence.dtype} == {torch.float32}
    torch.testing.assert_close(narrow.start.double(), draw(KINDS, ONE, 24).start, rtol=1e-6, atol=0.0)


def test_dead_ends_block_the_straight_way_and_leave_another():
    layouts = draw(["dead_end"])
    points = torch.linspace(0.0, 1.0, 400, dtype=torch.float64)[:, None, None]
    straight = layouts.start[:, 0, :3] + points * (ONE[0] - layouts.start[:, 0, :3])
    blocked = (layouts.obstacles.clearance(straight[:, :, None], RADIUS) < 0.0).any(-1).any(-1).any(0)
    assert float(blocked.double().mean()) > 0.95
    assert bool((spacing(layouts)[:, :-1] < 0.0).all())
    assert bool((spacing(layouts)[:, -1] > 2.0).all())
    assert bool(layouts.feasible(ONE, INFLATION).all())


def test_clusters_overlap():
    layouts = draw(["overlapping"])
    pairs = layouts.obstacles.present & layouts.obstacles.present.roll(-1, 1)
    within = pairs[:, [0, 1, 3, 4]]
    assert bool((spacing(layouts)[:, [0, 1, 3, 4]][within] < 0.0).all())


@pytest.mark.parametrize("targets", [ONE, THREE], ids=["one", "three"])
def test_closed_rings_are_infeasible_and_others_are_not(targets):
    layouts = draw(["ring"], targets)
    gaps = spacing(layouts)
    closed = gaps[:, -1] < 0.0
    assert bool((gaps[:, :-1] < 0.0).all())
    assert bool(((gaps[~closed, -1] > 1.0 - 1e-9) & (gaps[~closed, -1] < 3.0 + 1e-9)).all())
    assert 0.35 < float(closed.double().mean()) < 0.65
    assert torch.equal(layouts.feasible(targets, INFLATION), ~closed)
    assert not bool(layouts.feasible(targets, 1.6).any())


def test_rings_surround_starts_and_targets():
    layouts = draw(["ring"])
    # The middle of the chord from each disc to the one opposite it is the middle of the ring.
    around = 0.5 * (layouts.obstacles.centre[:, 0] + layouts.obstacles.centre[:, 12])
    closed = spacing(layouts)[:, -1] < 0.0
    start = torch.linalg.vector_norm(around - layouts.start[:, 0, :2], dim=-1)[closed] < 1e-6
    target = torch.linalg.vector_norm(around - ONE[0, :2], dim=-1)[closed] < 1e-6
    assert bool((start ^ target).all())
    assert 0.35 < float(start.double().mean()) < 0.65


def test_feasible_with_targets_of_each_world():
    layouts = draw(["ring"], THREE, 40)
    each = THREE.expand(40, 3, 3)
    assert torch.equal(layouts.feasible(each, INFLATION), layouts.feasible(THREE, INFLATION))


@pytest.mark.parametrize(("kinds", "got"), [(["maze", "ring"], "maze, ring"), ([], "none")])
def test_unknown_kind(kinds, got):
    message = rf"expected some of {', '.join(KINDS)}, got {got}"
    with pytest.raises(ValueError, match=message):
        draw(kinds)


def test_no_room(monkeypatch):
    monkeypatch.setattr(layouts_module, "ATTEMPTS", 20)
    with pytest.raises(RuntimeError, match="no acceptable layout of kind sparse in 20 attempts"):
        draw_layouts(RandomStreams.worlds(0, 2), ["sparse"], ONE, half_width_m=8.0)
