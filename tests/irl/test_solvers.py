"""The exact recursive solver against batch least squares on rebuilt rows, and Bellman rows against their definition."""

import io

import pytest
import torch

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.least_squares import Regularisation
from uwirl.irl.solvers import BatchLeastSquares, Bounds, ClassicalRls, Experience, ZRecursiveLeastSquares

SIZES, N2, LEARNERS = (3, 2), 4, 2
R = (0.3, 2.0)
STEPS, DT = 10, 0.05


@pytest.fixture
def operator() -> BellmanOperator:
    return BellmanOperator(N2, SIZES, R)


def trajectory(seed: int) -> tuple[torch.Tensor, ...]:
    """Smooth random phi2, phi3, q at 41 nodes and a held tau, of two learners."""
    generator = torch.Generator().manual_seed(seed)
    t = torch.arange(41, dtype=torch.float64)[:, None, None] * DT

    def smooth(n: int) -> torch.Tensor:
        a, w, p = torch.randn(3, LEARNERS, n, generator=generator, dtype=torch.float64)
        return a * torch.sin((1.0 + w.abs()) * t + p)

    tau = torch.randn(40, LEARNERS, len(SIZES), generator=generator, dtype=torch.float64)
    return smooth(N2), smooth(sum(SIZES)), tau, smooth(1)[..., 0].square()


def stretch(operator: BellmanOperator, seed: int, weight: float = 0.0) -> Experience:
    def segment(k: int) -> Segment:
        phi2, phi3, tau, q = trajectory(k)
        return operator.segment(phi2, phi3, tau, q, DT, STEPS, 5)

    return Experience(segment(seed), segment(seed + 1000) if weight else None, weight, 2.0)


@pytest.fixture
def weights() -> torch.Tensor:
    return torch.randn(LEARNERS, sum(SIZES), generator=torch.Generator().manual_seed(7), dtype=torch.float64)


def test_rows_match_their_definition(operator, weights):
    """Rows rebuilt from the policy-free vector are phi2(t) - phi2(t+T) and -2 R int phi3 (tau - W phi3), directly."""
    phi2, phi3, tau, q = trajectory(3)
    theta, y = operator.rows(operator.segment(phi2, phi3, tau, q, DT, STEPS, STEPS), weights)
    simpson = torch.tensor([1.0] + [4.0, 2.0] * 4 + [4.0, 1.0], dtype=torch.float64)[:, None, None] * DT / 3.0
    window = slice(STEPS, 2 * STEPS + 1)
    f2, f3, held = phi2[window], phi3[window], tau[STEPS : 2 * STEPS]
    torch.testing.assert_close(theta[1, :, :N2], f2[0] - f2[-1])
    cost = (q[window][..., None] * simpson).sum(0)[:, 0]
    for k, (axis, r) in enumerate(zip((slice(0, 3), slice(3, 5)), R, strict=True)):
        policy = (f3[..., axis] * weights[:, axis]).sum(-1, keepdim=True)
        drive = (held[..., k : k + 1] * (f3[1:, :, axis] + f3[:-1, :, axis])).sum(0) * DT / 2.0
        expected = -2.0 * r * (drive - (f3[..., axis] * policy * simpson).sum(0))
        torch.testing.assert_close(theta[1, :, N2:][:, axis], expected, rtol=0, atol=1e-12)
        cost = cost + r * (policy.square() * simpson).sum(0)[:, 0]
    torch.testing.assert_close(y[1], cost, rtol=0, atol=1e-12)


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("regularisation", [Regularisation(1e-7, 1e-3), Regularisation()])
def test_z_rls_equals_batch_on_rebuilt_rows(operator, weights, bounded, regularisation):
    bound = torch.full((sum(SIZES),), 0.2, dtype=torch.float64)
    bounds = Bounds(-bound, bound) if bounded else None
    recursive = ZRecursiveLeastSquares(operator, regularisation, bounds)
    batch = BatchLeastSquares(operator, regularisation, bounds)
    for seed in range(12):
        for solver in (recursive, batch):
            solver.add(stretch(operator, seed, weight=0.4))
    for policy in (weights, 3.0 * weights):
        for found, expected in zip(recursive.solve(policy), batch.solve(policy), strict=True):
            torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


def test_constant_memory(operator):
    solver = ZRecursiveLeastSquares(operator, Regularisation())
    shapes = set()
    for seed in range(3):
        solver.add(stretch(operator, seed))
        shapes.add(solver.Z_flown.shape)
    assert shapes == {(LEARNERS, N2 + 5 + 9 + 1, N2 + 5 + 9 + 1)}


def test_weighted_segments_weigh_their_squares(operator, weights):
    """A weight of 2 on every window of a stretch is the stretch added four times."""
    doubled = BatchLeastSquares(operator, Regularisation())
    repeated = BatchLeastSquares(operator, Regularisation())
    once, other = stretch(operator, 0), stretch(operator, 1)
    two = torch.full_like(once.flown.cost, 2.0)
    doubled.add(once._replace(flown=once.flown.weighted(two)))
    doubled.add(other)
    for experience in (once, once, once, once, other):
        repeated.add(experience)
    torch.testing.assert_close(doubled.solve(weights).actor, repeated.solve(weights).actor, rtol=1e-8, atol=1e-8)


def test_nothing_to_learn_from_is_refused(operator, weights):
    for family in (ZRecursiveLeastSquares, BatchLeastSquares):
        with pytest.raises(ValueError, match="no experience"):
            family(operator, Regularisation()).solve(weights)


def test_classical_rls_builds_a_row_for_the_policy_of_its_day(operator, weights):
    """Old rows stay as they were: solving again for another policy changes nothing until new rows come."""
    solver = ClassicalRls(operator, weights, kappa=1.0, p0=1e4, form="paper")
    solver.add(stretch(operator, 0))
    first = solver.solve(weights).actor.clone()
    torch.testing.assert_close(solver.solve(3.0 * weights).actor, first, rtol=0, atol=0)
    solver.add(stretch(operator, 1))
    assert not torch.allclose(solver.solve(weights).actor, first)


def plain(state: dict) -> dict:
    """Through a file, as a checkpoint goes, which takes plain data only."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    buffer.seek(0)
    return torch.load(buffer, weights_only=True)


BOUND = torch.full((sum(SIZES),), 0.2, dtype=torch.float64)
FAMILIES = {
    "z_rls": lambda operator, weights: ZRecursiveLeastSquares(operator, Regularisation(1e-7, 1e-3)),
    "bounded_z_rls": lambda operator, weights: ZRecursiveLeastSquares(
        operator, Regularisation(), Bounds(-BOUND, BOUND)
    ),
    "batch": lambda operator, weights: BatchLeastSquares(operator, Regularisation(1e-7, 1e-3)),
    "rls_paper": lambda operator, weights: ClassicalRls(operator, weights, 1.0, 1e4, "paper"),
    "rls_forgetting": lambda operator, weights: ClassicalRls(operator, weights, 0.99, 1e4, "exponential"),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("solved", [False, True])
def test_a_solver_goes_on_from_its_state_bitwise(operator, weights, family, solved):
    """Also where rows wait for their first policy; and what comes later does not change a state that was told."""
    make = FAMILIES[family]
    original = make(operator, weights)
    for seed in range(3):
        original.add(stretch(operator, seed, weight=0.4))
    if solved:
        original.solve(weights)
    told = original.state_dict()
    saved = plain(told)
    restored = make(operator, 0.0 * weights)
    restored.load_state_dict(saved)
    for policy in (weights, 3.0 * weights):
        for solver in (original, restored):
            solver.add(stretch(operator, 7, weight=0.2))
        for found, expected in zip(restored.solve(policy), original.solve(policy), strict=True):
            assert torch.equal(found, expected)
    late = make(operator, 0.0 * weights)
    late.load_state_dict(told)
    again = make(operator, 0.0 * weights)
    again.load_state_dict(saved)
    for solver in (late, again):
        solver.add(stretch(operator, 9))
    assert torch.equal(late.solve(weights).actor, again.solve(weights).actor)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_state_of_a_solver_that_knows_nothing_is_plain_too(operator, weights, family):
    solver = FAMILIES[family](operator, weights)
    solver.load_state_dict(plain(solver.state_dict()))
    solver.add(stretch(operator, 0))
    assert torch.isfinite(solver.solve(weights).actor).all()
