"""The generic learner on problems whose answer is known: gains of Riccati equations and one nonlinear closed form.

    python experiments/known_answers.py

Needs SciPy (extra `test`) for the Riccati solutions.
"""

from __future__ import annotations

from typing import Any

import hydra
import numpy as np
import torch
from omegaconf import DictConfig
from results import leave, tell
from scipy.linalg import solve_continuous_are
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.control_affine import simulate
from uwirl.irl.linear_quadratic import LinearQuadratic, f16, power_system
from uwirl.irl.policy_iteration import LearnerState, PolicyIteration
from uwirl.irl.solvers import Batch, BatchLeastSquares, Solver, ZRecursiveLeastSquares


def riccati_gain(problem: LinearQuadratic) -> Tensor:
    """K = R^-1 B'P of SciPy, [m, n]."""
    A, B, Q, R = problem.A.numpy(), problem.B.numpy(), problem.Q.numpy(), np.diag(problem.R.numpy())
    return torch.from_numpy(np.linalg.solve(R, B.T @ solve_continuous_are(A, B, Q, R)))


def relative_error(found: Tensor, expected: Tensor) -> float:
    """||found - expected|| / ||expected||."""
    return float(torch.linalg.vector_norm(found - expected) / torch.linalg.vector_norm(expected))


def learn(
    operator: BellmanOperator, solver: Solver[Any], segment: Segment, start: Tensor, updates: int = 30
) -> LearnerState[Any]:
    """Policy iteration on one stretch of experience [S, 1] from an admissible policy [1, n3]."""
    learner = PolicyIteration(solver, operator.unknowns, updates, tolerance=0.0)
    return learner.update(learner.init(start, start.new_zeros(1, operator.n2)), Batch((segment,)))


def column(segment: Segment, dtype: torch.dtype = torch.float64) -> Segment:
    """Windows [S] of one learner, [S, 1]."""
    return Segment(*(part.unsqueeze(1).to(dtype) for part in segment))


def exact_experience(problem: LinearQuadratic, generator: torch.Generator, T: float = 0.3) -> Segment:
    """Four times as many windows as unknowns, from random states under random constant controls."""
    n, m = problem.B.shape
    rows = 4 * problem.operator.unknowns
    x0 = torch.randn(rows, n, generator=generator, dtype=torch.float64)
    tau = torch.randn(rows, m, generator=generator, dtype=torch.float64)
    return problem.exact_segment(x0, tau, T)


def multisine(worlds: int, axes: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Frequencies (rad/s) and phases of four sines for each world and axis, [worlds, axes, 4] each."""
    u = torch.rand(2, worlds, axes, 4, generator=generator, dtype=torch.float64)
    return 1.0 + 9.0 * u[0], 2.0 * torch.pi * u[1]


def sampled_experience(problem: LinearQuadratic, K: Tensor, generator: torch.Generator) -> Segment:
    """200 windows of 0.1 s, sampled at dt = 0.01 s, under a gain K and a multisine."""
    worlds, dt, steps, windows = 20, 0.01, 10, 10
    n, m = problem.B.shape
    omega, phase = multisine(worlds, m, generator)

    def control(x: Tensor, t: float) -> Tensor:
        return -x @ K.T + torch.sin(omega * t + phase).sum(-1)

    x0 = torch.randn(worlds, n, generator=generator, dtype=torch.float64)
    x, tau = simulate(lambda x, tau: x @ problem.A.T + tau @ problem.B.T, control, x0, dt, steps * windows)
    basis = problem.basis
    q = ((x @ problem.Q) * x).sum(-1)
    segment = problem.operator.segment(basis.critic(x), basis.actor(x), tau, q, dt, steps, steps, held=False)
    return Segment(*(part.flatten(0, 1) for part in segment))


def known_linear_systems(generator: torch.Generator) -> dict[str, float]:
    """Gain errors on F-16 and power system: exact integrals, sampled rows, float32 through QR."""
    errors = {}
    for name, (problem, published) in {"f16": f16(), "power": power_system()}.items():
        expected = riccati_gain(problem)
        errors[f"published_gain_difference_{name}"] = float((expected - published).abs().max())
        start = torch.zeros(1, problem.operator.n3, dtype=torch.float64)
        solver = ZRecursiveLeastSquares(problem.operator)
        exact = exact_experience(problem, generator)
        learned = learn(problem.operator, solver, column(exact), start)
        errors[f"gain_error_{name}"] = relative_error(problem.gain(learned.actor)[0], expected)
        qr = BatchLeastSquares(problem.operator)
        learned = learn(problem.operator, qr, column(exact, torch.float32), start.float())
        errors[f"gain_error_{name}_float32"] = relative_error(problem.gain(learned.actor)[0].double(), expected)
        sampled = column(sampled_experience(problem, torch.zeros_like(expected), generator))
        learned = learn(problem.operator, qr, sampled, start)
        errors[f"gain_error_{name}_sampled"] = relative_error(problem.gain(learned.actor)[0], expected)
    return errors


def random_problem(generator: torch.Generator) -> LinearQuadratic:
    """2 to 5 states, 1 or 2 controls, stable or not; Q = C'C + I/10, R diagonal in [0.5, 2]."""
    n = int(torch.randint(2, 6, (1,), generator=generator))
    m = int(torch.randint(1, 3, (1,), generator=generator))

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    C = normal(n, n)
    Q = C.T @ C + 0.1 * torch.eye(n, dtype=torch.float64)
    R = 0.5 + 1.5 * torch.rand(m, generator=generator, dtype=torch.float64)
    return LinearQuadratic(normal(n, n), normal(n, m), Q, R)


def random_systems(count: int, generator: torch.Generator) -> tuple[list[float], list[float]]:
    """Gain errors on random systems through QR and through Z, started from the optimal gain of another cost."""
    errors: tuple[list[float], list[float]] = ([], [])
    for _ in range(count):
        problem = random_problem(generator)
        other = LinearQuadratic(problem.A, problem.B, torch.eye(len(problem.A), dtype=torch.float64), 0.3 * problem.R)
        start = -riccati_gain(other).flatten()[None]
        exact = column(exact_experience(problem, generator))
        solvers: tuple[Solver[Any], Solver[Any]] = (
            BatchLeastSquares(problem.operator),
            ZRecursiveLeastSquares(problem.operator),
        )
        for solver, found in zip(solvers, errors, strict=True):
            learned = learn(problem.operator, solver, exact, start)
            found.append(relative_error(problem.gain(learned.actor)[0], riccati_gain(problem)))
    return errors


class ClosedFormBasis:
    """Holds V* = x1^2/2 + x2^2 and tau* = -x2 sin x1, and more."""

    critic_names = ("x1^2", "x1x2", "x2^2", "x1^4", "x1^2x2^2", "x2^4")
    actor_names = (("x1sin", "x2sin"),)

    def critic(self, x: Tensor) -> Tensor:
        a, b = x.unbind(-1)
        return torch.stack([a * a, a * b, b * b, a**4, a * a * b * b, b**4], -1)

    def actor(self, x: Tensor) -> Tensor:
        return x * torch.sin(x[..., :1])


def nonlinear_closed_form(generator: torch.Generator) -> dict[str, float]:
    """f = [-x1 + x2; -(x1 + x2)/2 + x2 sin(x1)^2/2], g = [0; sin x1], q = x'x, R = 1, from tau = 0."""
    omega, phase = multisine(60, 1, generator)

    def dynamics(x: Tensor, tau: Tensor) -> Tensor:
        a, b = x.unbind(-1)
        s = torch.sin(a)
        return torch.stack([-a + b, -(a + b) / 2 + b * s * s / 2 + s * tau[..., 0]], -1)

    def control(x: Tensor, t: float) -> Tensor:
        return 0.3 * torch.sin(omega * t + phase).sum(-1)

    x0 = 2.0 * torch.rand(60, 2, generator=generator, dtype=torch.float64) - 1.0
    x, tau = simulate(dynamics, control, x0, 0.01, 200)
    basis = ClosedFormBasis()
    operator = BellmanOperator(6, [2], [1.0])
    segment = operator.segment(basis.critic(x), basis.actor(x), tau, x.square().sum(-1), 0.01, 10, 10, held=False)
    pooled = column(Segment(*(part.flatten(0, 1) for part in segment)))
    solver = BatchLeastSquares(operator)
    learned = learn(operator, solver, pooled, torch.zeros(1, 2, dtype=torch.float64))
    evaluated, _ = solver.solve(learned.solver, learned.actor)
    value = torch.tensor([[0.5, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    policy = torch.tensor([[0.0, -1.0]], dtype=torch.float64)
    return {
        "value_error_nonlinear": relative_error(evaluated.critic, value),
        "policy_error_nonlinear": relative_error(learned.actor, policy),
    }


@hydra.main(version_base="1.3", config_path="conf", config_name="known_answers")
def main(settings: DictConfig) -> None:
    """Print the errors and write them to metrics.json."""
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(settings.seed)
    metrics = known_linear_systems(generator)
    for solver, errors in zip(("qr", "z_rls"), random_systems(settings.random_systems, generator), strict=True):
        metrics[f"gain_error_random_{solver}_median"] = float(np.median(errors))
        metrics[f"gain_error_random_{solver}_max"] = max(errors)
    metrics |= nonlinear_closed_form(generator)
    tell(metrics, ".1e")
    leave({"seed": settings.seed, **metrics})


if __name__ == "__main__":
    main()
