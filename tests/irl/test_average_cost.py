"""The average cost as one more unknown, against Riccati equations and closed forms."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.linalg import solve_continuous_are
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.classical_rls import ClassicalRls
from uwirl.irl.linear_quadratic import LinearQuadratic, f16
from uwirl.irl.solvers import BatchLeastSquares, Bounds, ZRecursiveLeastSquares

EXPERIMENT = Path(__file__).parents[2] / "experiments" / "known_answers.py"
FAMILIES = (ZRecursiveLeastSquares, BatchLeastSquares)
T = 0.3


@pytest.fixture(scope="module")
def known():
    spec = importlib.util.spec_from_file_location("known_answers", EXPERIMENT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def with_average(problem: LinearQuadratic, critic_features: int | None = None) -> BellmanOperator:
    plain = problem.operator
    return BellmanOperator(critic_features or plain.n2, plain.sizes, problem.R, average_cost=True)


def problems(known, generator: torch.Generator) -> list[LinearQuadratic]:
    """F-16 and five random systems, but none that is nearly uncontrollable: there Z'Z loses half of the digits."""
    found = [f16()[0]]
    while len(found) < 6:
        problem = known.random_problem(generator)
        if float(known.riccati_gain(problem).norm()) < 30.0:
            found.append(problem)
    return found


def start_gain(known, problem: LinearQuadratic) -> Tensor:
    """Optimal for another cost, so admissible, [m, n]."""
    Q = torch.eye(len(problem.A), dtype=torch.float64)
    return known.riccati_gain(LinearQuadratic(problem.A, problem.B, Q, 0.3 * problem.R))


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("q0", [-3.0, 0.0, 5.0])
def test_a_constant_cost_is_the_average_and_leaves_the_gains_alone(known, generator, family, q0):
    for problem in problems(known, generator):
        operator = with_average(problem)
        segment = known.exact_experience(problem, generator, T)
        segment = known.column(segment._replace(cost=segment.cost + q0 * T))
        start = -start_gain(known, problem).flatten()[None]
        learned = known.learn(operator, family(operator), segment, start)
        assert known.relative_error(problem.gain(learned.actor)[0], known.riccati_gain(problem)) < 1e-8
        assert learned.average_cost.shape == (1,)
        assert float(learned.average_cost[0]) == pytest.approx(q0, abs=1e-8)


def test_without_the_column_a_constant_cost_spoils_the_gains(known, generator):
    problem, _ = f16()
    segment = known.exact_experience(problem, generator, T)
    segment = known.column(segment._replace(cost=segment.cost + 5.0 * T))
    start = torch.zeros(1, problem.operator.n3, dtype=torch.float64)
    learned = known.learn(problem.operator, BatchLeastSquares(problem.operator), segment, start)
    assert not known.relative_error(problem.gain(learned.actor)[0], known.riccati_gain(problem)) < 0.1
    assert learned.average_cost is None


def affine_optimum(problem: LinearQuadratic, d: Tensor, r: Tensor) -> tuple[Tensor, Tensor, Tensor, float]:
    """x_dot = A x + B tau + d, q = (x - r)'Q(x - r): V = x'P x + 2 s'x, tau = -R^-1 B'(P x + s).

    The linear and the constant terms of the Hamilton-Jacobi-Bellman equation of the cost less its average g_bar are

        (A - B R^-1 B'P)' s + P d - Q r = 0,   g_bar = r'Q r + 2 s'd - s'B R^-1 B's

    Returns:
        Gain [m, n + 1] on [x; 1], P, s and g_bar.
    """
    A, B, Q, R = problem.A.numpy(), problem.B.numpy(), problem.Q.numpy(), np.diag(problem.R.numpy())
    P = solve_continuous_are(A, B, Q, R)
    effect = B @ np.linalg.solve(R, B.T)
    s = np.linalg.solve((A - effect @ P).T, Q @ r.numpy() - P @ d.numpy())
    g = r.numpy() @ Q @ r.numpy() + 2.0 * s @ d.numpy() - s @ effect @ s
    gain = np.linalg.solve(R, B.T @ np.column_stack([P, s]))
    return torch.from_numpy(gain), torch.from_numpy(P), torch.from_numpy(s), float(g)


def affine_experience(
    problem: LinearQuadratic, d: Tensor, r: Tensor, generator: torch.Generator
) -> tuple[LinearQuadratic, Segment]:
    """The same as a linear-quadratic problem in [x; 1], and exact windows of it, whose last critic feature, 1, is left
    out."""
    n, m = problem.B.shape
    A, B, Q = (torch.zeros(n + 1, k, dtype=torch.float64) for k in (n + 1, m, n + 1))
    A[:n, :n], A[:n, n], B[:n] = problem.A, d, problem.B
    Q[:n, :n], Q[:n, n], Q[n, :n], Q[n, n] = problem.Q, -problem.Q @ r, -problem.Q @ r, r @ problem.Q @ r
    augmented = LinearQuadratic(A, B, Q, problem.R)
    rows = 4 * augmented.operator.unknowns
    x0 = torch.randn(rows, n + 1, generator=generator, dtype=torch.float64)
    x0[:, n] = 1.0
    tau = torch.randn(rows, m, generator=generator, dtype=torch.float64)
    segment = augmented.exact_segment(x0, tau, T)
    return augmented, segment._replace(drop=segment.drop[:, :-1])


@pytest.mark.parametrize("family", FAMILIES)
def test_a_steady_disturbance_and_a_minimum_out_of_reach(known, generator, family):
    """Holding x at r against d takes a control for ever: the least average cost is not zero, and it is found."""
    for problem in problems(known, generator):
        n = len(problem.A)
        d, r = torch.randn(2, n, generator=generator, dtype=torch.float64)
        augmented, segment = affine_experience(problem, d, r, generator)
        operator = with_average(augmented, len(augmented.basis.critic_names) - 1)
        gain = start_gain(known, problem)
        start = -torch.cat([gain, torch.zeros_like(gain[:, :1])], -1).flatten()[None]
        solver = family(operator)
        learned = known.learn(operator, solver, known.column(segment), start)
        expected, P, s, average = affine_optimum(problem, d, r)
        assert average > 0.0
        assert known.relative_error(augmented.gain(learned.actor)[0], expected) < 1e-8
        assert float(learned.average_cost[0]) == pytest.approx(average, rel=1e-8)
        first, second = torch.triu_indices(n + 1, n + 1)[:, :-1]
        V = torch.zeros(n + 1, n + 1, dtype=torch.float64)
        V[:n, :n], V[:n, n], V[n, :n] = P, s, s
        critic = V[first, second] * torch.where(first == second, 1.0, 2.0)
        assert known.relative_error(learned.critic[0], critic) < 1e-8


def test_bounds_and_prior_leave_the_average_cost_free(known, generator):
    """Bounds that hold nothing back and a prior in a fixed point change nothing; a tight bound holds the actor only."""
    problem, _ = f16()
    operator = with_average(problem)
    segment = known.exact_experience(problem, generator, T)
    segment = known.column(segment._replace(cost=segment.cost + 50.0 * T))
    start = torch.zeros(1, 3, dtype=torch.float64)
    wide, tight = (torch.full((3,), bound, dtype=torch.float64) for bound in (10.0, 0.2))
    for prior in (0.0, 1e-3):
        solver = ZRecursiveLeastSquares(operator, Bounds(-wide, wide), prior=prior)
        learned = known.learn(operator, solver, segment, start, updates=60)
        assert known.relative_error(problem.gain(learned.actor)[0], known.riccati_gain(problem)) < 1e-7
        assert float(learned.average_cost[0]) == pytest.approx(50.0, rel=1e-7)
    learned = known.learn(operator, ZRecursiveLeastSquares(operator, Bounds(-tight, tight)), segment, start)
    assert bool((learned.actor.abs() <= 0.2 + 1e-12).all())
    assert float(learned.average_cost[0]) > 1.0


def test_classical_rls_learns_it_too(known, generator):
    """One policy's rows: weights and average cost equal batch least squares."""
    problem, _ = f16()
    operator = with_average(problem)
    segment = known.exact_experience(problem, generator, T)
    segment = known.column(segment._replace(cost=segment.cost + 5.0 * T))
    start = torch.zeros(1, 3, dtype=torch.float64)
    recursive = known.learn(
        operator, ClassicalRls(operator, kappa=1.0, p0=1e10, form="paper"), segment, start, updates=1
    )
    batch = known.learn(operator, BatchLeastSquares(operator), segment, start, updates=1)
    for name in ("critic", "actor", "average_cost"):
        torch.testing.assert_close(getattr(recursive, name), getattr(batch, name), rtol=1e-5, atol=1e-5)


def test_a_window_tells_its_length(generator):
    operator = BellmanOperator(1, [1], [1.0], average_cost=True)
    phi = torch.randn(41, 3, 1, generator=generator, dtype=torch.float64)
    segment = operator.segment(phi, phi, phi[:-1], phi[..., 0], 0.05, 10, 5)
    torch.testing.assert_close(segment.duration, torch.full((7, 3), 0.5, dtype=torch.float64))
    doubled = segment.weighted(torch.full((7, 3), 2.0, dtype=torch.float64))
    torch.testing.assert_close(operator.z(doubled), 2.0 * operator.z(segment))
    theta, _ = operator.rows(segment, torch.ones(3, 1, dtype=torch.float64))
    torch.testing.assert_close(theta[..., -1], segment.duration)
