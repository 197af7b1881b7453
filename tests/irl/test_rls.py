"""Recursive least squares against batch solutions."""

import pytest
import torch

from uwirl.irl.rls import RecursiveLeastSquares

ROWS, UNKNOWNS, LEARNERS = 60, 5, 3


@pytest.fixture
def data() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    theta = torch.randn(ROWS, LEARNERS, UNKNOWNS, generator=generator, dtype=torch.float64)
    return theta, torch.randn(ROWS, LEARNERS, generator=generator, dtype=torch.float64)


def run(rls: RecursiveLeastSquares, theta: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    state = rls.init()
    for row, target in zip(theta, y, strict=True):
        state = rls.update(state, row, target)
    return state.weight


def weighted_ridge(theta, y, weights, penalty):
    A = theta.movedim(0, 1)
    N = A.mT @ (weights[:, None] * A) + penalty * torch.eye(UNKNOWNS, dtype=torch.float64)
    return torch.linalg.solve(N, (A.mT @ (weights[:, None] * y.T[..., None]))[..., 0])


@pytest.mark.parametrize("kappa", [0.01, 1.0, 5.0])
def test_paper_form_is_a_ridge_of_kappa_over_p0(data, kappa):
    """(49) as printed lacks 1/kappa: kappa is a penalty, not a forgetting factor."""
    theta, y = data
    found = run(RecursiveLeastSquares(UNKNOWNS, LEARNERS, kappa, p0=100.0, form="paper"), theta, y)
    expected = weighted_ridge(theta, y, torch.ones(ROWS, dtype=torch.float64), kappa / 100.0)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kappa", [0.9, 0.99, 1.0])
def test_exponential_form_forgets(data, kappa):
    theta, y = data
    found = run(RecursiveLeastSquares(UNKNOWNS, LEARNERS, kappa, p0=100.0), theta, y)
    age = torch.arange(ROWS - 1, -1, -1, dtype=torch.float64)
    # The prior, too, is forgotten.
    expected = weighted_ridge(theta, y, kappa**age, kappa**ROWS / 100.0)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-9)


def test_learners_do_not_mix(data):
    theta, y = data
    together = run(RecursiveLeastSquares(UNKNOWNS, LEARNERS), theta, y)
    alone = run(RecursiveLeastSquares(UNKNOWNS), theta[:, 1:2], y[:, 1:2])
    torch.testing.assert_close(together[1:2], alone, rtol=0, atol=1e-12)


def test_an_update_leaves_the_state_before_it_alone(data):
    theta, y = data
    rls = RecursiveLeastSquares(UNKNOWNS, LEARNERS, kappa=0.9)
    before = rls.update(rls.init(), theta[0], y[0])
    kept = [x.clone() for x in before]
    once, again = (rls.update(before, theta[1], y[1]) for _ in range(2))
    assert all(torch.equal(a, b) for a, b in zip(once, again, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(before, kept, strict=True))
    assert not torch.equal(once.weight, before.weight)


@pytest.mark.parametrize(("kappa", "form"), [(0.0, "paper"), (1.1, "exponential"), (1.0, "classical")])
def test_impossible_settings_are_refused(kappa, form):
    with pytest.raises(ValueError, match=r"kappa|form"):
        RecursiveLeastSquares(UNKNOWNS, kappa=kappa, form=form)
