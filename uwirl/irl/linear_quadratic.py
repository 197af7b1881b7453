"""Linear-quadratic problems, whose optimal gain is known, with window integrals in closed form.

x_dot = A x + B tau,   q = x'Q x,   V = x'P x,   tau = -K x,   K = R^-1 B'P
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment


class QuadraticBasis:
    """phi2 = all monomials x_i x_j with i <= j, phi3 = x on every control axis.

    Args:
        n: states.
        m: controls.
    """

    def __init__(self, n: int, m: int):
        self.first, self.second = torch.triu_indices(n, n)
        self.critic_names = tuple(f"x{i}x{j}" for i, j in zip(self.first.tolist(), self.second.tolist(), strict=True))
        self.actor_names = tuple(tuple(f"x{i}" for i in range(n)) for _ in range(m))

    def critic(self, x: Tensor) -> Tensor:
        """[..., n (n + 1) / 2]."""
        return x[..., self.first.to(x.device)] * x[..., self.second.to(x.device)]

    def actor(self, x: Tensor) -> Tensor:
        """[..., m n]."""
        return x.repeat(*[1] * (x.dim() - 1), len(self.actor_names))


@dataclass(frozen=True)
class LinearQuadratic:
    """A, B, Q [n, n] and the diagonal of R [m]."""

    A: Tensor
    B: Tensor
    Q: Tensor
    R: Tensor

    @property
    def basis(self) -> QuadraticBasis:
        """In which value and optimal policy are exact."""
        return QuadraticBasis(*self.B.shape)

    @property
    def operator(self) -> BellmanOperator:
        """Of that basis and R."""
        basis = self.basis
        return BellmanOperator(len(basis.critic_names), [len(names) for names in basis.actor_names], self.R)

    def gain(self, actor_weights: Tensor) -> Tensor:
        """K [..., m, n] of actor weights [..., m n]; the actor is tau = W'x = -K x."""
        return -actor_weights.unflatten(-1, (self.B.shape[1], self.B.shape[0]))

    def exact_segment(self, x0: Tensor, tau: Tensor, T: float) -> Segment:
        """Windows of length T from x0 [S, n] under constant tau [S, m], their integrals without quadrature.

        With y = [x; tau], y y' obeys a linear differential equation, so its integral is a matrix exponential.
        """
        n, m = self.B.shape
        F = self.A.new_zeros(n + m, n + m)
        F[:n, :n], F[:n, n:] = self.A, self.B
        identity = torch.eye(n + m).to(F)
        K = torch.kron(F, identity) + torch.kron(identity, F)
        size = (n + m) ** 2
        augmented = self.A.new_zeros(2 * size, 2 * size)
        augmented[:size, :size], augmented[:size, size:] = K, torch.eye(size).to(F)
        exponential = torch.linalg.matrix_exp(T * augmented)
        y0 = torch.cat([x0, tau], -1)
        products = (y0[:, :, None] * y0[:, None, :]).flatten(1)
        end = (products @ exponential[:size, :size].T).unflatten(1, (n + m, n + m))
        integral = (products @ exponential[:size, size:].T).unflatten(1, (n + m, n + m))
        basis = self.basis
        xx = integral[:, :n, :n]
        return Segment(
            drop=basis.critic(x0) - end[:, basis.first, basis.second],
            drive=integral[:, :n, n:].mT.flatten(1),
            gram=xx[:, basis.first, basis.second].repeat(1, m),
            cost=(self.Q * xx).sum((-2, -1)),
            duration=x0.new_full(x0.shape[:1], T),
        )


def f16() -> tuple[LinearQuadratic, Tensor]:
    """Short-period dynamics of an F-16 (B. L. Stevens and F. L. Lewis) and its optimal K, to four digits."""
    A = [[-1.01887, 0.90506, -0.00215], [0.82225, -1.07741, -0.17555], [0.0, 0.0, -1.0]]
    return _problem(A, [0.0, 0.0, 1.0]), torch.tensor([[-0.1352, -0.1501, 0.4329]], dtype=torch.float64)


def power_system() -> tuple[LinearQuadratic, Tensor]:
    """Load-frequency control of a power system (D. Vrabie and F. L. Lewis) and its optimal K, to four digits."""
    A = [[-0.0665, 11.5, 0.0, 0.0], [0.0, -2.5, 2.5, 0.0], [-9.5, 0.0, -13.736, -13.736], [0.6, 0.0, 0.0, 0.0]]
    K = torch.tensor([[0.7135, 2.7499, 0.7323, 0.4142]], dtype=torch.float64)
    return _problem(A, [0.0, 0.0, 13.736, 0.0]), K


def _problem(A: list[list[float]], B: list[float]) -> LinearQuadratic:
    """Q = I, R = 1."""
    column = torch.tensor(B, dtype=torch.float64)[:, None]
    identity = torch.eye(len(B), dtype=torch.float64)
    return LinearQuadratic(torch.tensor(A, dtype=torch.float64), column, identity, torch.ones(1, dtype=torch.float64))
