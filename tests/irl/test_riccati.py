"""The Riccati recursion against the solution of all its equations at once, and against SciPy's stationary gain."""

import numpy as np
import pytest
import torch
from scipy.linalg import solve_discrete_are

from uwirl.irl.riccati import LinearQuadratic, solve

N, K, n, m = 6, 3, 4, 2


def problem(bound: float = 1e9) -> tuple[LinearQuadratic, torch.Tensor]:
    draw = torch.Generator().manual_seed(3)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    root = normal(N, K, n + m, n + m)
    hessian = root @ root.mT + 0.1 * torch.eye(n + m, dtype=torch.float64)
    end = normal(K, n, n)
    cost = torch.cat([hessian, normal(N, K, n + m, 1)], -1)
    final = torch.cat([end @ end.mT, normal(K, n, 1)], -1)
    bounds = torch.full((N, K, m), bound, dtype=torch.float64)
    return LinearQuadratic(0.5 * normal(N, K, n, n + m + 1), cost, final, -bounds, bounds), normal(K, n)


def optimum(lq: LinearQuadratic, start: torch.Tensor, k: int) -> np.ndarray:
    """(du_0, dx_1, du_1, ..., dx_N) of one problem by its KKT equations."""
    size = N * (n + m)
    H, g = np.zeros((size, size)), np.zeros(size)
    A, b = np.zeros((N * n, size)), np.zeros(N * n)
    x0 = start[k].numpy()
    for t in range(N):
        F, f = lq.dynamics[t, k, :, :-1].numpy(), lq.dynamics[t, k, :, -1].numpy()
        C, c = lq.cost[t, k, :, :-1].numpy(), lq.cost[t, k, :, -1].numpy()
        u, after = slice(t * (n + m), t * (n + m) + m), slice(t * (n + m) + m, (t + 1) * (n + m))
        rows = slice(t * n, (t + 1) * n)
        H[u, u] += C[n:, n:]
        g[u] += c[n:]
        A[rows, after] += np.eye(n)
        A[rows, u] -= F[:, n:]
        b[rows] = f
        if t:
            x = slice(t * (n + m) - n, t * (n + m))
            H[x, x] += C[:n, :n]
            H[x, u] += C[:n, n:]
            H[u, x] += C[n:, :n]
            g[x] += c[:n]
            A[rows, x] -= F[:, :n]
        else:
            g[u] += C[n:, :n] @ x0
            b[rows] += F[:, :n] @ x0
    last = slice(size - n, size)
    H[last, last] += lq.final[k, :, :-1].numpy()
    g[last] += lq.final[k, :, -1].numpy()
    kkt = np.block([[H, A.T], [A, np.zeros((N * n, N * n))]])
    return np.linalg.solve(kkt, np.concatenate([-g, b]))[:size]


def test_solution_of_all_equations_at_once():
    lq, start = problem()
    step = solve(lq, start)
    for k in range(K):
        found = torch.cat([torch.cat([step.du[t, k], step.dx[t + 1, k]]) for t in range(N)])
        np.testing.assert_allclose(found.numpy(), optimum(lq, start, k), rtol=1e-9, atol=1e-10)


def test_a_batch_equals_its_singles():
    lq, start = problem()
    whole = solve(lq, start)
    for k in range(K):
        rows = torch.tensor([k])
        single = solve(
            LinearQuadratic(*(part[:, rows] if part.ndim == 4 or part.shape[0] == N else part[rows] for part in lq)),
            start[rows],
        )
        torch.testing.assert_close(single.du[:, 0], whole.du[:, k], rtol=1e-12, atol=1e-12)


def test_gain_of_a_long_horizon_is_scipys():
    draw = np.random.default_rng(1)
    A, B = np.eye(n) + 0.1 * draw.normal(size=(n, n)), draw.normal(size=(n, m))
    Q, R = np.eye(n), np.eye(m)
    P = solve_discrete_are(A, B, Q, R)
    expected = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    steps = 200
    zero = np.zeros
    dynamics = torch.tensor(np.hstack([A, B, zero((n, 1))])).expand(steps, 1, n, n + m + 1)
    cost = torch.tensor(np.hstack([np.block([[Q, zero((n, m))], [zero((m, n)), R]]), zero((n + m, 1))]))
    bounds = torch.full((steps, 1, m), 1e9, dtype=torch.float64)
    lq = LinearQuadratic(
        dynamics, cost.expand(steps, 1, n + m, -1), torch.tensor(np.hstack([Q, zero((n, 1))]))[None], -bounds, bounds
    )
    gain = solve(lq, torch.zeros(1, n, dtype=torch.float64)).gain[0, 0]
    np.testing.assert_allclose(gain.numpy(), expected, rtol=1e-9)


@pytest.mark.parametrize("bound", [0.0, 0.1])
def test_controls_stay_within_their_bounds(bound: float):
    lq, start = problem(bound)
    step = solve(lq, start)
    assert float(step.du.abs().max()) <= bound
    ahead = lq.dynamics @ torch.cat([step.dx[:-1], step.du, torch.ones(N, K, 1, dtype=torch.float64)], -1)[..., None]
    torch.testing.assert_close(step.dx[1:], ahead[..., 0], rtol=1e-12, atol=1e-12)
