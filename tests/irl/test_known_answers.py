"""The learner on problems whose answer is known from elsewhere."""

import importlib.util
from pathlib import Path

import pytest
import torch

from uwirl.irl.linear_quadratic import f16
from uwirl.irl.solvers import ZRecursiveLeastSquares

EXPERIMENT = Path(__file__).parents[2] / "experiments" / "known_answers.py"


@pytest.fixture(scope="module")
def known():
    spec = importlib.util.spec_from_file_location("known_answers", EXPERIMENT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_linear_systems(known, generator):
    errors = known.known_linear_systems(generator)
    for name in ("f16", "power"):
        assert errors[f"published_gain_difference_{name}"] < 5.1e-5  # four printed digits
        assert errors[f"gain_error_{name}"] < 1e-8
        assert errors[f"gain_error_{name}_sampled"] < 1e-5
        assert errors[f"gain_error_{name}_float32"] < 1e-4


def test_random_systems_against_scipy(known, generator):
    through_qr, _ = known.random_systems(100, generator)
    assert max(through_qr) < 1e-6


def test_nonlinear_closed_form(known, generator):
    errors = known.nonlinear_closed_form(generator)
    assert errors["value_error_nonlinear"] < 1e-6
    assert errors["policy_error_nonlinear"] < 1e-6


def test_printed_sign_converges_to_wrong_gains(known, generator):
    problem, _ = f16()
    operator = problem.operator
    operator.actor_sign = 1.0
    segment = known.column(known.exact_experience(problem, generator))
    start = torch.zeros(1, operator.n3, dtype=torch.float64)
    learned = known.learn(operator, ZRecursiveLeastSquares(operator), segment, start)
    assert not known.relative_error(problem.gain(learned.actor)[0], known.riccati_gain(problem)) < 0.1


def test_exact_windows_agree_with_quadrature(known):
    """The matrix exponential's integrals against Simpson's rule on a finely simulated trajectory."""
    problem, _ = f16()
    x0 = torch.tensor([[1.0, -0.5, 0.3]], dtype=torch.float64)
    tau = torch.tensor([[0.7]], dtype=torch.float64)
    x, controls = known.simulate(
        lambda x, u: x @ problem.A.T + u @ problem.B.T, lambda x, t: tau.expand(len(x), 1), x0, 0.003, 100
    )
    basis = problem.basis
    q = ((x @ problem.Q) * x).sum(-1)
    sampled = problem.operator.segment(basis.critic(x), basis.actor(x), controls, q, 0.003, 100, 100, held=False)
    exact_segment = problem.exact_segment(x0, tau, 0.3)
    assert exact_segment._fields == sampled._fields
    for exact, found in zip(exact_segment, sampled, strict=True):
        torch.testing.assert_close(exact, found[0], rtol=0, atol=1e-10)
