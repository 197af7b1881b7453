"""The exact recursive solver against batch least squares on rebuilt rows, and Bellman rows against their definition."""

import io
from typing import Any

import pytest
import torch

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.classical_rls import ClassicalRls
from uwirl.irl.least_squares import NormalEquations
from uwirl.irl.solvers import Batch, BatchLeastSquares, Bounds, Solver, ZRecursiveLeastSquares

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


def stretch(operator: BellmanOperator, seed: int, weight: float = 0.0) -> Batch:
    """Two groups, the second one with windows if its weight is not zero."""

    def segment(k: int) -> Segment:
        phi2, phi3, tau, q = trajectory(k)
        return operator.segment(phi2, phi3, tau, q, DT, STEPS, 5)

    return Batch((segment(seed), segment(seed + 1000) if weight else None), (1.0, weight))


def fed(solver: Solver, batches: list[Batch], weights: torch.Tensor) -> Any:
    """The solver's state after all of them."""
    state = solver.init(weights)
    for batch in batches:
        state = solver.add(state, batch)
    return state


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
@pytest.mark.parametrize("regularisation", [{"ridge": 1e-7, "prior": 1e-3}, {}])
def test_z_rls_equals_batch_on_rebuilt_rows(operator, weights, bounded, regularisation):
    bound = torch.full((sum(SIZES),), 0.2, dtype=torch.float64)
    bounds = Bounds(-bound, bound) if bounded else None
    solvers = [family(operator, bounds, **regularisation) for family in (ZRecursiveLeastSquares, BatchLeastSquares)]
    batches = [stretch(operator, seed, weight=0.4) for seed in range(12)]
    states = [fed(solver, batches, weights) for solver in solvers]
    for policy in (weights, 3.0 * weights):
        recursive, batch = (solver.solve(state, policy)[0] for solver, state in zip(solvers, states, strict=True))
        torch.testing.assert_close(recursive.critic, batch.critic, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(recursive.actor, batch.actor, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(recursive.residual, batch.residual, rtol=1e-7, atol=0)
        torch.testing.assert_close(recursive.condition, batch.condition, rtol=1e-6, atol=0)
        assert recursive.average_cost is None
        assert batch.average_cost is None


@pytest.mark.parametrize("family", [ZRecursiveLeastSquares, BatchLeastSquares])
def test_residual_and_condition_by_their_definition(operator, weights, family):
    solver = family(operator)
    batches = [stretch(operator, seed) for seed in range(12)]
    found, _ = solver.solve(fed(solver, batches, weights), weights)
    rows = [operator.rows(batch.groups[0], weights) for batch in batches]
    theta, y = (torch.cat(parts).movedim(0, 1) for parts in zip(*rows, strict=True))
    for k in range(LEARNERS):
        x = torch.cat([found.critic[k], found.actor[k]])
        assert float(found.residual[k]) == pytest.approx(float((theta[k] @ x - y[k]).norm() / y[k].norm()), rel=1e-6)
        scaled = theta[k] / theta[k].norm(dim=0)
        assert float(found.condition[k]) == pytest.approx(float(torch.linalg.cond(scaled)) ** 2, rel=1e-6)


def test_condition_of_what_is_singular_stays_finite():
    assert float(NormalEquations(torch.ones(2, 2), torch.ones(2), torch.ones(2)).condition()) > 1e6


def test_constant_memory(operator, weights):
    solver = ZRecursiveLeastSquares(operator)
    states = [fed(solver, [stretch(operator, seed) for seed in range(count)], weights) for count in (1, 2, 5)]
    assert {state.Z[0].shape for state in states} == {(LEARNERS, N2 + 5 + 9 + 1, N2 + 5 + 9 + 1)}
    assert [state.rows for state in states] == [(7, 0), (14, 0), (35, 0)]


def test_weighted_segments_weigh_their_squares(operator, weights):
    """A weight of 2 on every window of a stretch is the stretch added four times."""
    solver = BatchLeastSquares(operator)
    once, other = stretch(operator, 0), stretch(operator, 1)
    two = torch.full_like(once.groups[0].cost, 2.0)
    doubled = once._replace(groups=(once.groups[0].weighted(two), None))
    found, expected = (
        solver.solve(fed(solver, batches, weights), weights)[0].actor
        for batches in ([doubled, other], [once, once, once, once, other])
    )
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("family", [ZRecursiveLeastSquares, BatchLeastSquares])
def test_the_weight_of_a_group_is_that_of_each_of_its_squares(operator, weights, family):
    """The newest weight holds for all of the group, what came before it included."""
    solver = family(operator)
    grouped = [stretch(operator, seed, weight) for seed, weight in enumerate((0.9, 0.7, 0.25))]
    half = torch.full_like(grouped[0].groups[0].cost, 0.5)
    alone = [Batch((part,)) for batch in grouped for part in (batch.groups[0], batch.groups[1].weighted(half))]
    found, expected = (solver.solve(fed(solver, batches, weights), weights)[0] for batches in (grouped, alone))
    torch.testing.assert_close(found.actor, expected.actor, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(found.critic, expected.critic, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("family", [ZRecursiveLeastSquares, BatchLeastSquares])
def test_a_group_without_windows_or_without_weight_changes_nothing(operator, weights, family):
    solver = family(operator, ridge=1e-7, prior=1e-3)
    full = [stretch(operator, seed, weight=0.4) for seed in range(3)]
    variants = (
        [Batch(batch.groups[:1]) for batch in full],
        [Batch((batch.groups[0], None), (1.0, 0.4)) for batch in full],
        [Batch(batch.groups, (1.0, 0.0)) for batch in full],
    )
    first, *others = (solver.solve(fed(solver, batches, weights), weights)[0].actor for batches in variants)
    assert all(torch.equal(first, other) for other in others)


@pytest.mark.parametrize("family", [ZRecursiveLeastSquares, BatchLeastSquares])
def test_a_group_may_come_late_and_the_first_one_be_left_out(operator, weights, family):
    solver = family(operator, ridge=1e-7, prior=1e-3)
    a, b, c = (stretch(operator, seed, weight=0.4) for seed in range(3))
    late = [Batch((a.groups[0], None), (1.0, 0.4)), Batch((None, b.groups[1]), (1.0, 0.4)), c]
    merged = Batch(
        tuple(
            Segment(*(torch.cat(parts) for parts in zip(*segments, strict=True)))
            for segments in ((a.groups[0], c.groups[0]), (b.groups[1], c.groups[1]))
        ),
        (1.0, 0.4),
    )
    found, expected = (solver.solve(fed(solver, batches, weights), weights)[0].actor for batches in (late, [merged]))
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("family", [ZRecursiveLeastSquares, BatchLeastSquares])
def test_another_number_of_groups_is_refused(operator, weights, family):
    solver = family(operator)
    batch = stretch(operator, 0)
    with pytest.raises(ValueError, match="a batch of 1 groups follows batches of 2"):
        fed(solver, [batch, Batch(batch.groups[:1])], weights)


def test_nothing_to_learn_from_is_refused(operator, weights):
    for family in (ZRecursiveLeastSquares, BatchLeastSquares):
        solver = family(operator)
        with pytest.raises(ValueError, match="no experience"):
            solver.solve(solver.init(weights), weights)


def test_classical_rls_builds_a_row_for_the_policy_of_its_day(operator, weights):
    """Old rows stay as they were: solving again for another policy changes nothing until new rows come."""
    solver = ClassicalRls(operator, kappa=1.0, p0=1e4, form="paper")
    first, state = solver.solve(fed(solver, [stretch(operator, 0)], weights), weights)
    again, state = solver.solve(state, 3.0 * weights)
    assert torch.equal(again.actor, first.actor)
    later, _ = solver.solve(solver.add(state, stretch(operator, 1)), weights)
    assert not torch.allclose(later.actor, first.actor)


def test_classical_rls_starts_from_the_policys_weights(operator, weights):
    solver = ClassicalRls(operator, kappa=1.0, p0=1e4, form="paper")
    assert torch.equal(solver.solve(solver.init(weights), weights)[0].actor, weights)


BOUND = torch.full((sum(SIZES),), 0.2, dtype=torch.float64)
FAMILIES = {
    "z_rls": lambda operator: ZRecursiveLeastSquares(operator, ridge=1e-7, prior=1e-3),
    "bounded_z_rls": lambda operator: ZRecursiveLeastSquares(operator, Bounds(-BOUND, BOUND)),
    "batch": lambda operator: BatchLeastSquares(operator, ridge=1e-7, prior=1e-3),
    "bounded_batch": lambda operator: BatchLeastSquares(operator, Bounds(-BOUND, BOUND)),
    "rls_paper": lambda operator: ClassicalRls(operator, kappa=1.0, p0=1e4, form="paper"),
    "rls_forgetting": lambda operator: ClassicalRls(operator, kappa=0.99, p0=1e4, form="exponential"),
}


def through_a_file(state: Any) -> Any:
    """Saved and loaded as a checkpoint is, which takes plain data only."""
    buffer = io.BytesIO()
    torch.save(state._asdict(), buffer)
    buffer.seek(0)
    return type(state)(**torch.load(buffer, weights_only=True))


def leaves(state: Any) -> list[Any]:
    """All tensors and numbers in a state."""
    return [leaf for entry in state for leaf in leaves(entry)] if isinstance(state, tuple) else [state]


def same(a: Any, b: Any) -> bool:
    """Whether two states are bitwise equal."""
    pairs = list(zip(leaves(a), leaves(b), strict=True))
    return all(torch.equal(x, y) if isinstance(x, torch.Tensor) else x == y for x, y in pairs)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("known", [0, 3], ids=["fresh", "with experience"])
@pytest.mark.parametrize("solved", [False, True])
def test_a_solver_goes_on_from_a_saved_state_bitwise(operator, weights, family, known, solved):
    """Also where rows wait for their first policy."""
    solver = FAMILIES[family](operator)
    original = fed(solver, [stretch(operator, seed, weight=0.4) for seed in range(known)], weights)
    if solved and known:
        _, original = solver.solve(original, weights)
    restored = through_a_file(original)
    assert same(restored, original)
    for policy in (weights, 3.0 * weights):
        solutions, states = [], []
        for state in (original, restored):
            solution, state = solver.solve(solver.add(state, stretch(operator, 7, weight=0.2)), policy)
            solutions.append(solution)
            states.append(state)
        assert same(*solutions)
        original, restored = states


@pytest.mark.parametrize("family", FAMILIES)
def test_what_is_in_a_state_is_never_changed(operator, weights, family):
    solver = FAMILIES[family](operator)
    before = fed(solver, [stretch(operator, 0, weight=0.4)], weights)
    kept = through_a_file(before)
    added = [solver.add(before, stretch(operator, 1, weight=0.3)) for _ in range(2)]
    solved = [solver.solve(state, weights) for state in added]
    assert same(*added)
    assert same(*solved)
    assert not torch.equal(solver.solve(before, weights)[0].actor, solved[0][0].actor)
    assert same(before, kept)


@pytest.mark.parametrize("family", ["z_rls", "batch", "rls_paper"])
def test_everything_happens_on_the_device_of_the_input(weights, family):
    """On `meta`, which computes shapes alone and refuses to meet tensors that lie elsewhere."""
    operator = BellmanOperator(N2, SIZES, R, average_cost=True)
    phi2, phi3, tau, q = (part.to("meta") for part in trajectory(0))
    segment = operator.segment(phi2, phi3, tau, q, DT, STEPS, 5)
    solver = FAMILIES[family](operator)
    state = fed(solver, [Batch((segment, segment), (1.0, 0.5))] * 2, weights.to("meta"))
    solution, _ = solver.solve(state, weights.to("meta"))
    known = [part for part in solution if part is not None]
    assert {part.device.type for part in (*segment, *known)} == {"meta"}
    shapes = [(LEARNERS, N2), (LEARNERS, sum(SIZES)), (LEARNERS,), (LEARNERS,), (LEARNERS,)]
    # Classical RLS tells neither residual nor condition.
    assert [part.shape for part in known] == (shapes[:3] if family == "rls_paper" else shapes)


def broken(segment: Segment, name: str, value: float) -> Segment:
    part = getattr(segment, name).clone()
    part.flatten()[3] = value
    return segment._replace(**{name: part})


BAD = {
    "no groups": (lambda a: Batch((), ()), "without windows"),
    "no windows": (lambda a: Batch((None, None), (1.0, 0.5)), "without windows"),
    "empty windows": (lambda a: Batch((Segment(*(part[:0] for part in a)),)), "without windows"),
    "weights missing": (lambda a: Batch((a, a)), "2 groups of windows need as many weights, got 1"),
    "first weight": (lambda a: Batch((a,), (0.5,)), "begin with 1"),
    "negative weight": (lambda a: Batch((a, a), (1.0, -0.1)), "not negative"),
    "weight not a number": (lambda a: Batch((a, a), (1.0, float("nan"))), "finite"),
    "another number of learners": (
        lambda a: Batch((Segment(*(part[:, :1] for part in a)),)),
        r"drop of group 0 must be \[7, 2, ...\], got \[7, 1, 4\]",
    ),
    "no learners": (lambda a: Batch((Segment(*(part[:, 0] for part in a)),)), "drop of group 0 must be"),
    "fewer rows in one part": (lambda a: Batch((a._replace(gram=a.gram[:-1]),)), "gram of group 0 must be"),
    "not a number": (lambda a: Batch((a, broken(a, "cost", float("nan"))), (1.0, 1.0)), "cost of group 1 holds"),
    "infinite": (lambda a: Batch((broken(a, "drive", float("inf")),)), "drive of group 0 holds"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_batch_that_nothing_can_be_learned_from_is_refused(operator, case):
    make, message = BAD[case]
    good = stretch(operator, 0).groups[0]
    Batch((good, None, good), (1.0, 0.3, 0.0)).check(LEARNERS)
    with pytest.raises(ValueError, match=message):
        make(good).check(LEARNERS)
