"""Bounded quadratic programmes against SciPy, and their optimality conditions."""

import pytest
import torch
from scipy.optimize import lsq_linear

from uwirl.irl.least_squares import NormalEquations, bounded_quadratic


def random_problem(n: int, seed: int, batch: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    A = torch.randn(batch, 3 * n, n, generator=generator, dtype=torch.float64)
    return A, torch.randn(batch, 3 * n, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("seed", range(20))
def test_equals_scipy_lsq_linear(seed):
    n = 12
    A, y = random_problem(n, seed)
    lower = torch.full((n,), -0.1, dtype=torch.float64)
    upper = torch.full((n,), 0.05, dtype=torch.float64)
    lower[::4], upper[1::4] = -torch.inf, torch.inf
    found = bounded_quadratic(A.mT @ A, (A.mT @ y[..., None])[..., 0], lower, upper)[0]
    expected = lsq_linear(A[0].numpy(), y[0].numpy(), bounds=(lower.numpy(), upper.numpy()), tol=1e-14, method="bvls")
    torch.testing.assert_close(found, torch.from_numpy(expected.x), rtol=0, atol=1e-10)


def test_batch_equals_singles():
    A, y = random_problem(8, 3, batch=16)
    N, b = A.mT @ A, (A.mT @ y[..., None])[..., 0]
    bound = torch.full((8,), 0.1, dtype=torch.float64)
    together = bounded_quadratic(N, b, -bound, bound)
    for k in range(16):
        torch.testing.assert_close(together[k], bounded_quadratic(N[k], b[k], -bound, bound), rtol=0, atol=1e-12)


def test_terminates_on_nearly_singular_problems():
    """Strongly correlated columns, on which methods that exchange whole blocks of bounds cycle."""
    generator = torch.Generator().manual_seed(1)
    base = torch.randn(64, 60, 1, generator=generator, dtype=torch.float64)
    A = base + 1e-3 * torch.randn(64, 60, 20, generator=generator, dtype=torch.float64)
    y = torch.randn(64, 60, generator=generator, dtype=torch.float64)
    N, b = A.mT @ A, (A.mT @ y[..., None])[..., 0]
    bound = torch.ones(20, dtype=torch.float64)
    x = bounded_quadratic(N, b, -bound, bound)
    gradient = (N @ x[..., None])[..., 0] - b
    assert ((x >= -1.0) & (x <= 1.0)).all()
    scale = b.abs().amax(-1, keepdim=True)
    inside = (x.abs() < 1.0 - 1e-9).double()
    assert (gradient.abs() * inside / scale).max() < 1e-9
    assert (gradient * (x >= 1.0 - 1e-9) / scale).max() < 1e-9
    assert (gradient * (x <= -1.0 + 1e-9) / scale).min() > -1e-9


def test_not_a_number_is_an_error_not_a_loop():
    bound = torch.ones(3, dtype=torch.float64)
    with pytest.raises(ArithmeticError, match="not positive definite"):
        bounded_quadratic(
            torch.eye(3, dtype=torch.float64), torch.full((3,), torch.nan, dtype=torch.float64), -bound, bound
        )


def test_scaling_leaves_the_solution_alone():
    A, y = random_problem(6, 5)
    A = A * torch.logspace(-4, 4, 6, dtype=torch.float64)
    N, b = (A.mT @ A)[0], (A.mT @ y[..., None])[0, :, 0]
    expected = torch.linalg.lstsq(A[0], y[0, :, None]).solution[:, 0]
    torch.testing.assert_close(NormalEquations.scaled(N, b).solve(), expected, rtol=1e-9, atol=0)
