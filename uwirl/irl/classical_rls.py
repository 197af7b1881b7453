"""Policy evaluation by classical recursive least squares, with which the exact recursive solver is compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.rls import RecursiveLeastSquares, RlsState
from uwirl.irl.solvers import Batch, Bounds, Parts, Solution


class ClassicalRlsState(NamedTuple):
    """What the rows so far have taught, and segments whose rows are not built yet.

    Attributes:
        weight, P: as in RlsState.
        pending: segments that wait for their policy, as plain tuples of their tensors.
    """

    weight: Tensor
    P: Tensor
    pending: tuple[Parts, ...]


@dataclass(frozen=True)
class ClassicalRls:
    """RLS as printed, or with exponential forgetting: a row is built once, for the policy of its day.

    Neither form revises the rows of old policies, so both learn worse than the exact solver; here for comparison. It
    learns from the first group alone.

    Attributes:
        operator: builds the rows.
        bounds: as other solvers have them; this one heeds none.
        kappa, p0, form: see RecursiveLeastSquares.
    """

    operator: BellmanOperator
    bounds: Bounds | None = None
    kappa: float = 1.0
    p0: float = 1e4
    form: str = "paper"

    def init(self, weights: Tensor) -> ClassicalRlsState:
        """P = p0 I, and the actor's weights [L, n3] as the first estimate."""
        weight, P = self._rls(weights).init()
        n2, n3 = self.operator.n2, self.operator.n3
        weight[:, n2 : n2 + n3] = weights
        return ClassicalRlsState(weight, P, ())

    def add(self, state: ClassicalRlsState, batch: Batch) -> ClassicalRlsState:
        """With the first group's windows, which wait for the policy that their rows are built for."""
        first = batch.groups[0]
        return state if first is None else state._replace(pending=(*state.pending, tuple(first)))

    def solve(self, state: ClassicalRlsState, weights: Tensor) -> tuple[Solution, ClassicalRlsState]:
        """Build the rows that wait for the policy of weights [L, n3], take them in one by one."""
        rls, known = self._rls(weights), RlsState(state.weight, state.P)
        for parts in state.pending:
            for theta, y in zip(*self.operator.rows(Segment(*parts), weights), strict=True):
                known = rls.update(known, theta, y)
        return Solution(*self.operator.split(known.weight)), ClassicalRlsState(*known, ())

    def _rls(self, weights: Tensor) -> RecursiveLeastSquares:
        unknowns, learners = self.operator.unknowns, weights.shape[0]
        return RecursiveLeastSquares(unknowns, learners, self.kappa, self.p0, self.form, weights.dtype, weights.device)
