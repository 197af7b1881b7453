"""Policy iteration (42)-(49), and Algorithm 1's second loop: a generator of records that neither logs nor saves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.irl.networks import LinearActor, LinearCritic
from uwirl.irl.solvers import Experience, Solver


class InsufficientDataError(ValueError):
    """Fewer rows than unknowns."""


class InadmissiblePolicyError(ValueError):
    """The policy to start from does not bring the cost down."""


@dataclass(frozen=True)
class StoppingRule:
    """When to stop.

    Attributes:
        tolerance: epsilon_3: stop once ||W^(s) - W^(s-1)|| / ||W^(s-1)|| of the actor stays below it for a stretch of
            experience, over all of its updates.
        max_seconds: T_max,2, in vehicle time, s.
    """

    tolerance: float
    max_seconds: float


@dataclass(frozen=True)
class IterationRecord:
    """One policy evaluation and improvement.

    Attributes:
        iteration: s, from 1.
        seconds: vehicle time used so far, s.
        critic: weights [L, n2].
        actor: weights of the improved policy, [L, n3].
        weight_change: relative change of the actor's weights, the largest over the learners.
        converged: epsilon_3 holds.
        rows: of experience so far, for each learner.
        closes: whether it is the last of its stretch of experience; what follows is new experience, or the end.
    """

    iteration: int
    seconds: float
    critic: Tensor
    actor: Tensor
    weight_change: float
    converged: bool
    rows: int
    closes: bool


def policy_iteration(
    experience: Iterable[Experience],
    solver: Solver,
    actor: LinearActor,
    critic: LinearCritic,
    updates: int,
    stopping: StoppingRule,
    seconds: float = 0.0,
    after: IterationRecord | None = None,
) -> Iterator[IterationRecord]:
    """Learn from experience until the weights settle or the time is up.

    The actor's weights are set in place, so experience flown lazily with that actor follows the newest policy.

    Args:
        experience: stretches of experience; with `after`, those that follow it.
        solver: policy evaluation and improvement.
        actor, critic: hold the weights.
        updates: policy iterations for each stretch.
        stopping: when to stop.
        seconds: vehicle time used before, s.
        after: a record that closed its stretch, to continue from as if never interrupted: its weights are set here;
            the solver must know what it knew then. Nothing follows a record that ended learning.

    Yields:
        One record an iteration.

    Raises:
        InsufficientDataError: the time was up, or experience ended, with fewer rows than unknowns.
    """
    unknowns = actor.weight.shape[-1] + critic.weight.shape[-1]
    iteration, rows = 0, 0
    if after is not None:
        iteration, rows, seconds = after.iteration, after.rows, after.seconds
        actor.weight.copy_(after.actor)
        critic.weight.copy_(after.critic)
        if after.converged or seconds >= stopping.max_seconds:
            return
    for stretch in experience:
        solver.add(stretch)
        seconds += stretch.seconds
        rows += stretch.rows
        settled = rows >= unknowns
        for update in range(1, updates + 1 if rows >= unknowns else 1):
            solution = solver.solve(actor.weight)
            change = _relative_change(solution.actor, actor.weight)
            actor.weight.copy_(solution.actor)
            critic.weight.copy_(solution.critic)
            settled = settled and change < stopping.tolerance
            iteration += 1
            closes = update == updates
            weights = critic.weight.clone(), actor.weight.clone()
            yield IterationRecord(iteration, seconds, *weights, change, settled and closes, rows, closes)
        if settled or seconds >= stopping.max_seconds:
            break
    if not iteration:
        raise InsufficientDataError(f"{rows} rows of experience for {unknowns} unknown weights: fly longer")


def _relative_change(new: Tensor, old: Tensor) -> float:
    norm = torch.linalg.vector_norm
    return float((norm(new - old, dim=-1) / norm(old, dim=-1).clamp_min(1e-12)).max())
