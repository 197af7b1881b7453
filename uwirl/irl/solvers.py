"""How Bellman rows become new weights: one exact recursive solver, and those it is compared with."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.least_squares import NormalEquations, Regularisation
from uwirl.irl.rls import RecursiveLeastSquares


class Experience(NamedTuple):
    """What one stretch of flight teaches L learners.

    Attributes:
        flown: windows as they were flown, [S, L].
        relabelled: the same motion seen from other frames, [S', L], or None.
        relabelled_weight: weight of everything relabelled so far against everything flown.
        seconds: vehicle time of this stretch, s.
    """

    flown: Segment
    relabelled: Segment | None
    relabelled_weight: float
    seconds: float

    @property
    def rows(self) -> int:
        """Windows in it for each learner."""
        return self.flown.cost.shape[0] + (0 if self.relabelled is None else self.relabelled.cost.shape[0])


class Solution(NamedTuple):
    """Weights of critic [L, n2] and improved actor [L, n3]."""

    critic: Tensor
    actor: Tensor


class Bounds(NamedTuple):
    """Bounds on the actor's weights, [n3] each."""

    lower: Tensor
    upper: Tensor


class Solver(Protocol):
    """Turns experience and the present policy into the next one."""

    def add(self, experience: Experience) -> None:
        """Take in a stretch of experience."""
        ...

    def solve(self, weights: Tensor) -> Solution:
        """Evaluate the policy [L, n3] and improve it."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """All that was learned so far, as tensors, numbers and lists; later experience does not change it."""
        ...

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there, bitwise."""
        ...


class LeastSquaresPolicyEvaluation:
    """Penalties and bounds, which the recursive and the batch solver share."""

    def __init__(self, operator: BellmanOperator, regularisation: Regularisation, bounds: Bounds | None):
        self.operator = operator
        self.regularisation = regularisation
        self.bounds = bounds

    def penalty(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Penalty [n] and its centre [L, n] at a policy [L, n3]."""
        n2, n3 = self.operator.n2, self.operator.n3
        penalty = weights.new_full((n2 + n3,), self.regularisation.ridge)
        penalty[n2:] += self.regularisation.prior
        return penalty, torch.cat([weights.new_zeros(*weights.shape[:-1], n2), weights], -1)

    def finish(self, equations: NormalEquations) -> Solution:
        """Solve, within the bounds where there are any."""
        if self.bounds is None:
            x = equations.solve()
        else:
            free = self.bounds.lower.new_full((self.operator.n2,), torch.inf)
            x = equations.solve(torch.cat([-free, self.bounds.lower]), torch.cat([free, self.bounds.upper]))
        return Solution(x[..., : self.operator.n2], x[..., self.operator.n2 :])


class ZRecursiveLeastSquares(LeastSquaresPolicyEvaluation):
    """Exact recursive solver: Z <- Z + z z' knows no policy, N = L(W) Z L(W)' and b = L(W) Z l(W) serve any.

    Constant memory, no forgetting, and every old reading is re-evaluated for the newest policy; equal to batch least
    squares on rebuilt rows.
    """

    _STATE = ("Z_flown", "Z_relabelled", "n_flown", "n_relabelled", "relabelled_weight")

    def __init__(self, operator: BellmanOperator, regularisation: Regularisation, bounds: Bounds | None = None):
        super().__init__(operator, regularisation, bounds)
        self.Z_flown: Tensor | None = None
        self.Z_relabelled: Tensor | None = None
        self.n_flown = self.n_relabelled = 0
        self.relabelled_weight = 0.0

    def state_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self._STATE}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self._STATE:
            setattr(self, name, state[name])

    def add(self, experience: Experience) -> None:
        self.Z_flown = self._accumulate(self.Z_flown, experience.flown)
        self.n_flown += experience.flown.cost.shape[0]
        self.relabelled_weight = experience.relabelled_weight
        if experience.relabelled is not None:
            self.Z_relabelled = self._accumulate(self.Z_relabelled, experience.relabelled)
            self.n_relabelled += experience.relabelled.cost.shape[0]

    @staticmethod
    def _accumulate(Z: Tensor | None, segment: Segment) -> Tensor:
        z = segment.z.movedim(0, -2)
        products = z.mT @ z
        return products if Z is None else Z + products

    def solve(self, weights: Tensor) -> Solution:
        if self.Z_flown is None:
            raise ValueError("no experience to learn from")
        Z, n = self.Z_flown, float(self.n_flown)
        if self.Z_relabelled is not None:
            Z, n = Z + self.relabelled_weight * self.Z_relabelled, n + self.relabelled_weight * self.n_relabelled
        L, target = self.operator.lift(weights)
        LZ = L @ Z / n
        equations = NormalEquations.scaled(LZ @ L.mT, (LZ @ target[..., None])[..., 0])
        return self.finish(equations.regularised(*self.penalty(weights)))


class BatchLeastSquares(LeastSquaresPolicyEvaluation):
    """Keeps every segment, rebuilds all rows for each policy and factors them by QR (which also serves float32)."""

    def __init__(self, operator: BellmanOperator, regularisation: Regularisation, bounds: Bounds | None = None):
        super().__init__(operator, regularisation, bounds)
        self.flown: list[Segment] = []
        self.relabelled: list[Segment] = []
        self.relabelled_weight = 0.0

    def state_dict(self) -> dict[str, Any]:
        return {
            "flown": [list(segment) for segment in self.flown],
            "relabelled": [list(segment) for segment in self.relabelled],
            "relabelled_weight": self.relabelled_weight,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.flown = [Segment(*parts) for parts in state["flown"]]
        self.relabelled = [Segment(*parts) for parts in state["relabelled"]]
        self.relabelled_weight = state["relabelled_weight"]

    def add(self, experience: Experience) -> None:
        self.flown.append(experience.flown)
        self.relabelled_weight = experience.relabelled_weight
        if experience.relabelled is not None:
            self.relabelled.append(experience.relabelled)

    def solve(self, weights: Tensor) -> Solution:
        if not self.flown:
            raise ValueError("no experience to learn from")
        theta, y, total = self._weighted_rows(weights)
        rms = torch.sqrt((theta**2).sum(-2) / total) + 1e-12
        penalty, centre = self.penalty(weights)
        # Penalties become rows, so that the normal equations are never formed.
        A = torch.cat(
            [theta / rms[..., None, :] / total**0.5, torch.diag(penalty.sqrt()).expand(*theta.shape[:-2], -1, -1)], -2
        )
        rhs = torch.cat([y / total**0.5, penalty.sqrt() * centre * rms], -1)
        Q, R = torch.linalg.qr(A)
        projected = Q.mT @ rhs[..., None]
        if self.bounds is None:
            x = torch.linalg.solve_triangular(R, projected, upper=True)[..., 0] / rms
            return Solution(x[..., : self.operator.n2], x[..., self.operator.n2 :])
        return self.finish(NormalEquations(R.mT @ R, (R.mT @ projected)[..., 0], rms))

    def _weighted_rows(self, weights: Tensor) -> tuple[Tensor, Tensor, float]:
        """Rows [L, S, n] and targets [L, S], each times the root of its weight, and the sum of the weights."""
        parts = [(segment, 1.0) for segment in self.flown]
        if self.relabelled_weight > 0.0:
            parts += [(segment, self.relabelled_weight) for segment in self.relabelled]
        blocks, targets, total = [], [], 0.0
        for segment, weight in parts:
            theta, y = self.operator.rows(segment, weights)
            blocks.append(theta.movedim(0, -2) * weight**0.5)
            targets.append(y.movedim(0, -1) * weight**0.5)
            total += weight * y.shape[0]
        return torch.cat(blocks, -2), torch.cat(targets, -1), total


class ClassicalRls:
    """RLS as printed, or with exponential forgetting: a row is built once, for the policy of its day.

    Neither form revises the rows of old policies, so both learn worse than the exact solver; here for comparison.
    """

    def __init__(self, operator: BellmanOperator, weights: Tensor, kappa: float, p0: float, form: str):
        self.operator = operator
        self.rls = RecursiveLeastSquares(operator.unknowns, weights.shape[0], kappa, p0, form, weights.dtype)
        self.rls.weight[:, operator.n2 :] = weights
        self.pending: list[Segment] = []

    def state_dict(self) -> dict[str, Any]:
        pending = [list(segment) for segment in self.pending]
        return {"weight": self.rls.weight, "P": self.rls.P, "pending": pending}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.rls.weight, self.rls.P = state["weight"], state["P"]
        self.pending = [Segment(*parts) for parts in state["pending"]]

    def add(self, experience: Experience) -> None:
        self.pending.append(experience.flown)

    def solve(self, weights: Tensor) -> Solution:
        for segment in self.pending:
            for theta, y in zip(*self.operator.rows(segment, weights), strict=True):
                self.rls.update(theta, y)
        self.pending.clear()
        n2 = self.operator.n2
        return Solution(self.rls.weight[:, :n2], self.rls.weight[:, n2:])
