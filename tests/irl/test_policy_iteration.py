"""Policy iteration: what a state says, when learning settles, and that states are values."""

import io
from collections.abc import Iterator
from itertools import islice
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor

from uwirl.irl.bellman import Segment
from uwirl.irl.linear_quadratic import f16
from uwirl.irl.networks import LinearActor
from uwirl.irl.policy_iteration import InsufficientDataError, Iterate, LearnerState, PolicyIteration, learn
from uwirl.irl.solvers import Batch, Solution, ZRecursiveLeastSquares

PROBLEM = f16()[0]


def batches(rows: int) -> Iterator[Batch]:
    generator = torch.Generator().manual_seed(0)
    while True:
        x0 = torch.randn(rows, 3, generator=generator, dtype=torch.float64)
        tau = torch.randn(rows, 1, generator=generator, dtype=torch.float64)
        segment = PROBLEM.exact_segment(x0, tau, 0.3)
        yield Batch((Segment(*(part.unsqueeze(1) for part in segment)),))


def make_learner(updates: int = 2, tolerance: float = 0.0) -> PolicyIteration:
    solver = ZRecursiveLeastSquares(PROBLEM.operator)
    return PolicyIteration(solver, PROBLEM.operator.unknowns, updates, tolerance)


def begin(learner: PolicyIteration) -> LearnerState:
    return learner.init(torch.zeros(1, 3, dtype=torch.float64), torch.zeros(1, 6, dtype=torch.float64))


def run(stretches: int = 3, rows: int = 40, updates: int = 2, tolerance: float = 0.0) -> list[LearnerState]:
    learner = make_learner(updates, tolerance)
    return list(learn(learner, begin(learner), islice(batches(rows), stretches)))


def test_before_any_experience():
    actor, critic = torch.ones(1, 3, dtype=torch.float64), torch.ones(1, 6, dtype=torch.float64)
    state = make_learner().init(actor, critic)
    actor.zero_()
    critic.zero_()
    assert bool((state.actor == 1.0).all())
    assert bool((state.critic == 1.0).all())
    assert (state.rows, state.iteration, state.settled, state.iterates) == (0, 0, False, ())


def test_every_stretch_brings_its_iterates():
    states = run()
    assert [[iterate.iteration for iterate in state.iterates] for state in states] == [[1, 2], [3, 4], [5, 6]]
    assert [state.iteration for state in states] == [2, 4, 6]
    assert [state.rows for state in states] == [40, 80, 120]
    assert not any(state.settled for state in states)
    for state in states:
        assert torch.equal(state.actor, state.iterates[-1].actor)
        assert torch.equal(state.critic, state.iterates[-1].critic)
        assert state.average_cost is None
    before, after = states[0].iterates
    change = (after.actor - before.actor).norm() / before.actor.norm()
    assert after.change == pytest.approx(float(change), rel=1e-12)


def test_settled_means_every_update_of_the_stretch():
    states = run(stretches=100, updates=5, tolerance=1e-6)
    assert len(states) < 100
    assert states[-1].settled
    assert not any(state.settled for state in states[:-1])
    assert all(iterate.change < 1e-6 for iterate in states[-1].iterates)
    # The last update of the stretch before was no longer a change, its first one was.
    assert states[-2].iterates[0].change >= 1e-6 > states[-2].iterates[-1].change


def test_cost_falls_from_iterate_to_iterate():
    """P of successive policies is monotonically decreasing (Kleinman)."""
    x = torch.randn(50, 1, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    features = PROBLEM.basis.critic(x)
    values = torch.stack([(features * state.critic).sum(-1)[:, 0] for state in run(stretches=6, updates=1)])
    assert (values.diff(dim=0) < 1e-9 * values[:-1].abs()).all()


def test_waits_for_enough_rows():
    states = run(rows=4)  # 9 unknowns
    assert [len(state.iterates) for state in states] == [0, 0, 2]
    assert [state.rows for state in states] == [4, 8, 12]
    assert bool((states[1].actor == 0.0).all())


def test_too_few_rows_is_an_error():
    with pytest.raises(InsufficientDataError, match="6 rows of experience for 9 unknown weights"):
        run(rows=2)


def test_weights_of_the_wrong_length_are_refused():
    with pytest.raises(ValueError, match="2 entries, its basis 3 features"):
        LinearActor(PROBLEM.basis, torch.zeros(1, 2))


def test_impossible_beginnings_are_refused():
    with pytest.raises(ValueError, match="2 actors and 1 critics"):
        make_learner().init(torch.zeros(2, 3), torch.zeros(1, 6))
    with pytest.raises(ValueError, match="at least one update"):
        make_learner(updates=0)


def test_bad_batches_are_refused():
    """`test_solvers` holds all the ways in which a batch may be bad."""
    learner = make_learner()
    batch = next(batches(5))
    state = learner.update(begin(learner), batch)
    for bad in (
        Batch((None,)),
        Batch((Segment(*(part.expand(-1, 2, *part.shape[2:]) for part in batch.groups[0])),)),
        Batch((batch.groups[0]._replace(cost=torch.full((5, 1), torch.nan, dtype=torch.float64)),)),
    ):
        with pytest.raises(ValueError, match=r"without windows|must be \[5, 1, ...\]|not finite"):
            learner.update(state, bad)


def through_a_file(state: LearnerState) -> LearnerState:
    """Saved and loaded as plain data."""
    iterates = [tuple(iterate) for iterate in state.iterates]
    buffer = io.BytesIO()
    torch.save({**state._asdict(), "solver": state.solver._asdict(), "iterates": iterates}, buffer)
    buffer.seek(0)
    saved = torch.load(buffer, weights_only=True)
    solver, iterates = type(state.solver)(**saved.pop("solver")), saved.pop("iterates")
    return LearnerState(solver=solver, iterates=tuple(Iterate(*iterate) for iterate in iterates), **saved)


def leaves(state: Any) -> list[Any]:
    return [leaf for entry in state for leaf in leaves(entry)] if isinstance(state, tuple) else [state]


def same(a: LearnerState, b: LearnerState) -> bool:
    pairs = list(zip(leaves(a), leaves(b), strict=True))
    return all(torch.equal(x, y) if isinstance(x, Tensor) else x == y for x, y in pairs)


def test_an_update_is_a_function():
    """The same state and batch give the same, bitwise, and the state stays as it was."""
    learner = make_learner()
    first, second = islice(batches(40), 2)
    before = learner.update(begin(learner), first)
    kept = through_a_file(before)
    once, again = learner.update(before, second), learner.update(before, second)
    assert same(once, again)
    assert same(before, kept)
    assert not torch.equal(once.actor, before.actor)


def test_saved_after_any_stretch_it_goes_on_as_if_never_interrupted():
    """Also after the first stretch, which has fewer rows than unknowns."""
    learner = make_learner(updates=3)
    whole = list(learn(learner, begin(learner), islice(batches(7), 5)))
    for done, state in enumerate(whole[:-1], 1):
        later = islice(batches(7), done, 5)
        rest = list(learn(learner, through_a_file(state), later))
        assert len(rest) == 5 - done
        assert all(same(found, expected) for found, expected in zip(rest, whole[done:], strict=True))


class MeanState(NamedTuple):
    total: Tensor
    count: int


class HalfWayToTheMean:
    """Improves weights [L, 2, 3] half the way to the mean of all windows; its critic has weights [L, 6, 1, 1]."""

    def init(self, weights: Tensor) -> MeanState:
        assert weights.shape == (2, 2, 3)
        return MeanState(torch.zeros_like(weights), 0)

    def add(self, state: MeanState, batch: Batch) -> MeanState:
        total = sum(segment.drop.unflatten(-1, (2, 3)).sum(0) for segment in batch.groups if segment is not None)
        return MeanState(state.total + total, state.count + batch.rows)

    def solve(self, state: MeanState, weights: Tensor) -> tuple[Solution, MeanState]:
        improved = (weights + state.total / state.count) / 2.0
        return Solution(weights.flatten(1)[..., None, None], improved), state


def test_weights_may_have_any_shape():
    """W_s = mean + (W_0 - mean) / 2^s for each of two learners."""
    generator = torch.Generator().manual_seed(2)
    drop = torch.randn(8, 2, 6, generator=generator, dtype=torch.float64)
    start = torch.randn(2, 2, 3, generator=generator, dtype=torch.float64)
    zeros = torch.zeros(8, 2, dtype=torch.float64)
    segment = Segment(drop, torch.zeros(8, 2, 4), torch.zeros(8, 2, 1), zeros, zeros + 0.3)
    learner = PolicyIteration(HalfWayToTheMean(), unknowns=12, updates=3, tolerance=0.1)
    state = learner.init(start, torch.zeros(2, 6, 1, 1, dtype=torch.float64))
    first, second, third = learn(learner, state, [Batch((segment,))] * 3)
    assert first.iterates == ()
    mean = drop.mean(0).unflatten(-1, (2, 3))
    for iterate in (*second.iterates, *third.iterates):
        before, after = (mean + (start - mean) / 2.0**s for s in (iterate.iteration - 1, iterate.iteration))
        torch.testing.assert_close(iterate.actor, after, rtol=0, atol=1e-12)
        torch.testing.assert_close(iterate.critic, before.flatten(1)[..., None, None], rtol=0, atol=1e-12)
        change = max(float((after - before)[k].norm() / before[k].norm()) for k in range(2))
        assert iterate.change == pytest.approx(change, rel=1e-9)
    assert third.iteration == 6
    assert third.settled is all(iterate.change < 0.1 for iterate in third.iterates)
