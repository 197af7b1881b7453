"""Stopping, records and refusals of policy iteration."""

from dataclasses import replace
from itertools import islice

import pytest
import torch

from uwirl.irl.least_squares import Regularisation
from uwirl.irl.linear_quadratic import LinearQuadratic, f16
from uwirl.irl.networks import LinearActor, LinearCritic
from uwirl.irl.policy_iteration import InsufficientDataError, StoppingRule, policy_iteration
from uwirl.irl.solvers import Experience, ZRecursiveLeastSquares


def stretches(problem: LinearQuadratic, rows: int, seconds: float):
    generator = torch.Generator().manual_seed(0)
    while True:
        x0 = torch.randn(rows, 3, generator=generator, dtype=torch.float64)
        tau = torch.randn(rows, 1, generator=generator, dtype=torch.float64)
        segment = problem.exact_segment(x0, tau, 0.3)
        yield Experience(type(segment)(*(part.unsqueeze(1) for part in segment)), None, 0.0, seconds)


def run(rows: int = 40, updates: int = 2, tolerance: float = 0.0, max_seconds: float = 30.0):
    problem, _ = f16()
    actor = LinearActor(problem.basis, torch.zeros(1, 3, dtype=torch.float64))
    critic = LinearCritic(problem.basis)
    solver = ZRecursiveLeastSquares(problem.operator, Regularisation())
    stopping = StoppingRule(tolerance, max_seconds)
    return (
        actor,
        critic,
        list(policy_iteration(stretches(problem, rows, 10.0), solver, actor, critic, updates, stopping)),
    )


def test_stops_at_the_time_limit():
    _, _, records = run()
    assert [record.iteration for record in records] == [1, 2, 3, 4, 5, 6]
    assert [record.seconds for record in records] == [10.0, 10.0, 20.0, 20.0, 30.0, 30.0]
    assert not any(record.converged for record in records)


def test_stops_when_the_weights_settle():
    _, _, records = run(updates=4, tolerance=1e-6, max_seconds=1e6)
    assert records[-1].converged
    assert not any(record.converged for record in records[:-1])
    assert all(record.weight_change < 1e-6 for record in records[-4:])


def test_records_hold_copies_and_modules_the_newest_weights():
    actor, critic, records = run()
    torch.testing.assert_close(records[-1].actor, actor.weight, rtol=0, atol=0)
    torch.testing.assert_close(records[-1].critic, critic.weight, rtol=0, atol=0)
    assert not torch.equal(records[0].actor, records[-1].actor)


def test_cost_falls_from_iterate_to_iterate():
    """P of successive policies is monotonically decreasing (Kleinman)."""
    _, _, records = run(updates=1, max_seconds=60.0)
    x = torch.randn(50, 1, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    basis = f16()[0].basis
    values = torch.stack([(basis.critic(x) * record.critic).sum(-1)[:, 0] for record in records])
    assert (values.diff(dim=0) < 1e-9 * values[:-1].abs()).all()


def test_waits_for_enough_rows():
    _, _, records = run(rows=4)  # 9 unknowns
    assert records[0].seconds == 30.0


def test_too_few_rows_is_an_error():
    with pytest.raises(InsufficientDataError, match="6 rows of experience for 9 unknown weights"):
        run(rows=2)


def test_weights_of_the_wrong_length_are_refused():
    with pytest.raises(ValueError, match="2 entries, its basis 3 features"):
        LinearActor(f16()[0].basis, torch.zeros(1, 2))


def test_resumed_after_any_stretch_it_ends_as_if_never_interrupted():
    problem, _ = f16()
    stopping = StoppingRule(0.0, 60.0)

    def begin():
        actor = LinearActor(problem.basis, torch.zeros(1, 3, dtype=torch.float64))
        return actor, LinearCritic(problem.basis), ZRecursiveLeastSquares(problem.operator, Regularisation())

    actor, critic, solver = begin()
    whole, states = [], []
    for record in policy_iteration(stretches(problem, 7, 10.0), solver, actor, critic, 3, stopping):
        whole.append(record)
        if record.closes:
            states.append((len(whole), solver.state_dict()))
    # The first stretch has fewer rows than unknowns: it teaches nothing yet.
    assert [count for count, _ in states] == [3, 6, 9, 12, 15]
    for flown, (count, state) in enumerate(states, 2):
        actor, critic, solver = begin()
        solver.load_state_dict(state)
        later = islice(stretches(problem, 7, 10.0), flown, None)
        rest = list(policy_iteration(later, solver, actor, critic, 3, stopping, after=whole[count - 1]))
        assert len(rest) == len(whole) - count
        for found, expected in zip(rest, whole[count:], strict=True):
            assert torch.equal(found.actor, expected.actor)
            assert torch.equal(found.critic, expected.critic)
            assert replace(found, actor=None, critic=None) == replace(expected, actor=None, critic=None)
        assert torch.equal(actor.weight, whole[-1].actor)


@pytest.mark.parametrize(("converged", "seconds"), [(True, 10.0), (False, 30.0)])
def test_nothing_follows_the_end_of_learning(converged: bool, seconds: float):
    actor, critic, records = run()
    end = replace(records[-1], converged=converged, seconds=seconds)

    def no_flight():
        raise AssertionError("flew on")
        yield

    problem, _ = f16()
    solver = ZRecursiveLeastSquares(problem.operator, Regularisation())
    actor.weight.zero_()
    assert list(policy_iteration(no_flight(), solver, actor, critic, 2, StoppingRule(0.0, 30.0), after=end)) == []
    assert torch.equal(actor.weight, end.actor)
