"""How Bellman rows become new weights: what a solver is, an exact recursive one, and batch least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.irl.least_squares import NormalEquations

S = TypeVar("S")
T = TypeVar("T")
# A segment's tensors as a plain tuple, as a file takes it.
Parts = tuple[Tensor, ...]


class Batch(NamedTuple):
    """What one stretch of experience teaches L learners: groups of windows that count apart.

    Attributes:
        groups: windows [S_k, L] of each group; None where a group has none in this stretch.
        weights: of everything in group k so far, against that of group 0, so that weights[0] is 1.
    """

    groups: tuple[Segment | None, ...]
    weights: tuple[float, ...] = (1.0,)

    @property
    def rows(self) -> int:
        """Windows in it for each learner."""
        return sum(windows(segment) for segment in self.groups)

    def check(self, learners: int) -> None:
        """Refuse what nothing can be learned from.

        Args:
            learners: L.

        Raises:
            ValueError: no windows, not one weight for each group, weights that do not begin with 1 or are negative or
                not finite, windows of another number of learners, or entries that are not finite.
        """
        if not self.rows:
            raise ValueError("a batch without windows teaches nothing")
        if len(self.weights) != len(self.groups):
            raise ValueError(f"{len(self.groups)} groups of windows need as many weights, got {len(self.weights)}")
        if self.weights[0] != 1.0 or not all(0.0 <= weight < float("inf") for weight in self.weights):
            raise ValueError(f"weights of groups are finite, not negative and begin with 1, got {self.weights}")
        for k, segment in enumerate(self.groups):
            for name, part in () if segment is None else segment._asdict().items():
                if part.shape[:2] != (windows(segment), learners):
                    expected = f"[{windows(segment)}, {learners}, ...]"
                    raise ValueError(f"{name} of group {k} must be {expected}, got {list(part.shape)}")
                if not bool(part.isfinite().all()):
                    raise ValueError(f"{name} of group {k} holds entries that are not finite")


class Solution(NamedTuple):
    """An evaluated policy, improved.

    Attributes:
        critic: weights of its critic, [L, n2] where that is linear.
        actor: weights of the improved policy, [L, n3] where that is linear.
        average_cost: its g_bar, [L]; None where that is known to be zero.
        residual: root mean square error of the Bellman equations over that of their right-hand side, [L]; None where it
            is not computed, as with the next.
        condition: condition number of the normal equations, regressors scaled to unit mean square, [L].
    """

    critic: Tensor
    actor: Tensor
    average_cost: Tensor | None = None
    residual: Tensor | None = None
    condition: Tensor | None = None


class Bounds(NamedTuple):
    """Bounds on the actor's weights, [n3] each."""

    lower: Tensor
    upper: Tensor


class Solver(Protocol[S]):
    """Turns experience and the present policy into the next one.

    Its state S is a NamedTuple of tensors, numbers and plain tuples of them, so that it can be saved, moved and gone on
    from. What is in a state is never changed: every method gives a new one.
    """

    def init(self, weights: Tensor) -> S:
        """What it knows before any experience; `weights` [L, ...] are those of the policy to start from."""
        ...

    def add(self, state: S, batch: Batch) -> S:
        """Take in a stretch of experience."""
        ...

    def solve(self, state: S, weights: Tensor) -> tuple[Solution, S]:
        """Evaluate the policy of weights [L, ...] and improve it."""
        ...


@dataclass(frozen=True)
class LeastSquaresPolicyEvaluation:
    """Penalties and bounds, which the recursive and the batch solver share.

    Penalties are quadratic, in units where every regressor has unit mean square, so that they need no tuning to scale.

    Attributes:
        operator: builds the rows.
        bounds: on the actor's weights.
        ridge: penalty on every unknown, towards zero.
        prior: penalty on the actor's weights, towards the present policy.
        bounded: whether the bounds hold, if there are any.
    """

    operator: BellmanOperator
    bounds: Bounds | None = None
    ridge: float = 0.0
    prior: float = 0.0
    bounded: bool = True

    def penalty(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Penalty [n] and its centre [L, n] at a policy [L, n3]."""
        n2, n3, n = self.operator.n2, self.operator.n3, self.operator.unknowns
        penalty = weights.new_full((n,), self.ridge)
        penalty[n2 : n2 + n3] += self.prior
        centre = weights.new_zeros(*weights.shape[:-1], n)
        centre[..., n2 : n2 + n3] = weights
        return penalty, centre

    def unknowns(self, equations: NormalEquations) -> Tensor:
        """The solution [L, n] of equations with penalties, within the bounds where there are any."""
        if self.bounds is None or not self.bounded:
            return equations.solve()
        actor = slice(self.operator.n2, self.operator.n2 + self.operator.n3)
        lower = self.bounds.lower.new_full((self.operator.unknowns,), -torch.inf)
        upper = -lower
        lower[actor], upper[actor] = self.bounds
        return equations.solve(lower, upper)


class ZState(NamedTuple):
    """All experience in constant memory; each field has one entry a group, and is empty before the first batch.

    Attributes:
        Z: sum of z z', [L, nz, nz]; None before the group's first window.
        rows: windows in that sum.
        weights: of the groups.
    """

    Z: tuple[Tensor | None, ...] = ()
    rows: tuple[int, ...] = ()
    weights: tuple[float, ...] = ()


class ZRecursiveLeastSquares(LeastSquaresPolicyEvaluation):
    """Exact recursive solver: Z <- Z + z z' knows no policy, N = L(W) Z L(W)' and b = L(W) Z l(W) serve any.

    Constant memory, no forgetting, and every old reading is re-evaluated for the newest policy; equal to batch least
    squares on rebuilt rows.
    """

    def init(self, weights: Tensor) -> ZState:
        """Before any experience."""
        return ZState()

    def add(self, state: ZState, batch: Batch) -> ZState:
        """With the windows of a batch; `state` stays as it is."""
        Z, rows = _known(state.Z, None, batch), _known(state.rows, 0, batch)
        return ZState(
            tuple(self._accumulate(*pair) for pair in zip(Z, batch.groups, strict=True)),
            tuple(n + windows(segment) for n, segment in zip(rows, batch.groups, strict=True)),
            batch.weights,
        )

    def _accumulate(self, Z: Tensor | None, segment: Segment | None) -> Tensor | None:
        if segment is None:
            return Z
        z = self.operator.z(segment).movedim(0, -2)
        products = z.mT @ z
        return products if Z is None else Z + products

    def solve(self, state: ZState, weights: Tensor) -> tuple[Solution, ZState]:
        """Evaluate the policy of weights [L, n3] on all experience and improve it, by least squares."""
        Z, n = self._total(state)
        L, target = self.operator.lift(weights)
        LZ = L @ Z / n
        equations = NormalEquations.scaled(LZ @ L.mT, (LZ @ target[..., None])[..., 0])
        penalised = equations.regularised(*self.penalty(weights))
        x = self.unknowns(penalised)
        power = (target * (Z @ target[..., None])[..., 0]).sum(-1) / n
        return Solution(*self.operator.split(x), equations.residual(x, power), penalised.condition()), state

    @staticmethod
    def _total(state: ZState) -> tuple[Tensor, float]:
        """Sum of z z' over all groups, each with its weight, [L, nz, nz], and that of the weights of all windows."""
        total, n = None, 0.0
        for Z, rows, weight in zip(state.Z, state.rows, state.weights, strict=True):
            if Z is None or weight == 0.0:
                continue
            Z = Z if weight == 1.0 else weight * Z
            total = Z if total is None else total + Z
            n += weight * rows
        if total is None:
            raise ValueError("no experience to learn from")
        return total, n


class SegmentsState(NamedTuple):
    """All experience as it came; each field has one entry a group, and is empty before the first batch.

    Attributes:
        stretches: the segments of each stretch, as plain tuples of their tensors.
        weights: of the groups.
    """

    stretches: tuple[tuple[Parts, ...], ...] = ()
    weights: tuple[float, ...] = ()


class BatchLeastSquares(LeastSquaresPolicyEvaluation):
    """Keeps every segment, rebuilds all rows for each policy and factors them by QR (which also serves float32)."""

    def init(self, weights: Tensor) -> SegmentsState:
        """Before any experience."""
        return SegmentsState()

    def add(self, state: SegmentsState, batch: Batch) -> SegmentsState:
        """With the windows of a batch; `state` stays as it is."""
        stretches = _known(state.stretches, (), batch)
        return SegmentsState(
            tuple(
                before if segment is None else (*before, tuple(segment))
                for before, segment in zip(stretches, batch.groups, strict=True)
            ),
            batch.weights,
        )

    def solve(self, state: SegmentsState, weights: Tensor) -> tuple[Solution, SegmentsState]:
        """Evaluate the policy of weights [L, n3] on all experience and improve it, by least squares."""
        theta, y, total = self._weighted_rows(state, weights)
        rms = torch.sqrt((theta**2).sum(-2) / total) + 1e-12
        penalty, centre = self.penalty(weights)
        # Penalties become rows, so that the normal equations are never formed.
        A = torch.cat(
            [theta / rms[..., None, :] / total**0.5, torch.diag(penalty.sqrt()).expand(*theta.shape[:-2], -1, -1)], -2
        )
        rhs = torch.cat([y / total**0.5, penalty.sqrt() * centre * rms], -1)
        Q, R = torch.linalg.qr(A)
        projected = Q.mT @ rhs[..., None]
        equations = NormalEquations(R.mT @ R, (R.mT @ projected)[..., 0], rms)
        if self.bounds is None or not self.bounded:
            x = torch.linalg.solve_triangular(R, projected, upper=True)[..., 0] / rms
        else:
            x = self.unknowns(equations)
        error = (theta @ x[..., None])[..., 0] - y
        residual = torch.linalg.vector_norm(error, dim=-1) / torch.linalg.vector_norm(y, dim=-1)
        return Solution(*self.operator.split(x), residual, equations.condition()), state

    def _weighted_rows(self, state: SegmentsState, weights: Tensor) -> tuple[Tensor, Tensor, float]:
        """Rows [L, S, n] and targets [L, S], each times the root of its weight, and the sum of the weights."""
        blocks, targets, total = [], [], 0.0
        for stretches, weight in zip(state.stretches, state.weights, strict=True):
            for parts in stretches if weight > 0.0 else ():
                theta, y = self.operator.rows(Segment(*parts), weights)
                blocks.append(theta.movedim(0, -2) * weight**0.5)
                targets.append(y.movedim(0, -1) * weight**0.5)
                total += weight * y.shape[0]
        if not blocks:
            raise ValueError("no experience to learn from")
        return torch.cat(blocks, -2), torch.cat(targets, -1), total


def windows(segment: Segment | None) -> int:
    """S of a segment [S, ...]; none of a group that has none."""
    return 0 if segment is None else segment.cost.shape[0]


def _known(before: tuple[T, ...], nothing: T, batch: Batch) -> tuple[T, ...]:
    """One entry for each of the batch's groups: those before it, or `nothing` if it is the first."""
    known = before or (nothing,) * len(batch.groups)
    if len(known) != len(batch.groups):
        raise ValueError(f"a batch of {len(batch.groups)} groups follows batches of {len(known)}")
    return known
