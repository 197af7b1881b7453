"""Policy iteration (42)-(49) with an explicit state: what was learned goes in, what is learned comes out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import torch
from torch import Tensor

from uwirl.irl.solvers import Batch, Solver

S = TypeVar("S")


class InsufficientDataError(ValueError):
    """Fewer rows than unknowns."""


class InadmissiblePolicyError(ValueError):
    """The policy to start from does not bring the cost down."""


class Iterate(NamedTuple):
    """One policy evaluation and improvement.

    Attributes:
        iteration: s, from 1.
        critic: weights of the evaluated policy's critic, [L, n2] where that is linear.
        actor: weights of the improved policy, [L, n3] where that is linear.
        change: ||W^(s) - W^(s-1)|| / ||W^(s-1)|| of the actor's weights, the largest over the learners.
        residual, condition: see Solution, the largest over the learners; None if the solver does not tell.
    """

    iteration: int
    critic: Tensor
    actor: Tensor
    change: float
    residual: float | None = None
    condition: float | None = None


class LearnerState(NamedTuple, Generic[S]):
    """All that L learners know; enough to go on bitwise.

    Attributes:
        solver: what the solver keeps of experience.
        critic: newest weights, [L, n2] where the critic is linear.
        actor: newest weights, [L, n3] where the actor is linear.
        average_cost: newest g_bar, [L]; None where it is known to be zero, or before the first iteration.
        rows: of experience so far, for each learner.
        iteration: policy iterations so far.
        settled: whether the actor's weights changed by less than the tolerance in every update of the newest stretch.
        iterates: of the newest stretch; empty while there are fewer rows than unknowns.
    """

    solver: S
    critic: Tensor
    actor: Tensor
    average_cost: Tensor | None
    rows: int
    iteration: int
    settled: bool
    iterates: tuple[Iterate, ...]


@dataclass(frozen=True)
class PolicyIteration(Generic[S]):
    """Policy evaluation and improvement, a few times for each stretch of experience.

    Attributes:
        solver: evaluates and improves.
        unknowns: rows of experience that are needed before the first iteration.
        updates: policy iterations for each stretch.
        tolerance: epsilon_3, below which a relative change of the actor's weights counts as none.

    Raises:
        ValueError: no updates.
    """

    solver: Solver[S]
    unknowns: int
    updates: int
    tolerance: float

    def __post_init__(self) -> None:
        if self.updates < 1:
            raise ValueError(f"a stretch of experience needs at least one update, got {self.updates}")

    def init(self, actor: Tensor, critic: Tensor) -> LearnerState[S]:
        """Before any experience.

        Args:
            actor: weights of the policy to start from, [L, ...].
            critic: weights until the first iteration, [L, ...].

        Raises:
            ValueError: actor and critic of different numbers of learners.
        """
        if actor.shape[0] != critic.shape[0]:
            raise ValueError(f"weights of {actor.shape[0]} actors and {critic.shape[0]} critics do not belong together")
        # Copies, since whoever holds these weights may set them anew.
        return LearnerState(self.solver.init(actor), critic.clone(), actor.clone(), None, 0, 0, False, ())

    def update(self, state: LearnerState[S], batch: Batch) -> LearnerState[S]:
        """Learn from a stretch of experience; `state` stays as it is.

        Raises:
            ValueError: a batch that nothing can be learned from, see `Batch.check`.
        """
        batch.check(state.actor.shape[0])
        solver, rows = self.solver.add(state.solver, batch), state.rows + batch.rows
        state = state._replace(solver=solver, rows=rows, settled=rows >= self.unknowns, iterates=())
        for _ in range(self.updates if rows >= self.unknowns else 0):
            state = self._iterate(state)
        return state

    def _iterate(self, state: LearnerState[S]) -> LearnerState[S]:
        solution, solver = self.solver.solve(state.solver, state.actor)
        change = _relative_change(solution.actor, state.actor)
        # Copies in row order: how a product rounds depends on the layout, which a state that comes back from elsewhere
        # has lost, and a view would keep all that was solved for in memory.
        critic, actor = (
            weights.clone(memory_format=torch.contiguous_format) for weights in (solution.critic, solution.actor)
        )
        told = (None if part is None else float(part.max()) for part in (solution.residual, solution.condition))
        iterate = Iterate(state.iteration + 1, critic, actor, change, *told)
        return state._replace(
            solver=solver,
            critic=critic,
            actor=actor,
            average_cost=None if solution.average_cost is None else solution.average_cost.clone(),
            iteration=iterate.iteration,
            settled=state.settled and change < self.tolerance,
            iterates=(*state.iterates, iterate),
        )


def learn(learner: PolicyIteration[S], state: LearnerState[S], batches: Iterable[Batch]) -> Iterator[LearnerState[S]]:
    """Learn from stretches of experience until the weights settle or experience ends.

    Args:
        learner: policy iteration.
        state: what is known before.
        batches: stretches of experience.

    Yields:
        The state after each stretch.

    Raises:
        InsufficientDataError: experience ended with fewer rows than unknowns.
    """
    for batch in batches:
        state = learner.update(state, batch)
        yield state
        if state.settled:
            return
    if state.rows < learner.unknowns:
        raise InsufficientDataError(f"{state.rows} rows of experience for {learner.unknowns} unknown weights")


def _relative_change(new: Tensor, old: Tensor) -> float:
    new, old = new.flatten(1), old.flatten(1)
    norm = torch.linalg.vector_norm
    return float((norm(new - old, dim=-1) / norm(old, dim=-1).clamp_min(1e-12)).max())
