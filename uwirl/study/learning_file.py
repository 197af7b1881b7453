"""Learners in checkpoints: saving and restoring state and history, and parts that another run can use."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from uwirl.irl.networks import Basis
from uwirl.irl.policy_iteration import LearnerState
from uwirl.motion.experience import FlightState
from uwirl.motion.identification import Identified, Log
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError
from uwirl.world.acoustics import LinkBudget
from uwirl.world.trajectory import WorldState

# Keys that every checkpoint of a run contains, and those of one that holds only a channel estimate.
NEEDED = ("config", "config_hash", "overrides", "estimate", "actor", "trim", "model", "features", "iteration")
ESTIMATE = ("config", "config_hash", "estimate", "known_loss_dB")
# Where link budgets are compared, m.
DISTANCES_M = (1.0, 100.0, 10_000.0)
_NUMBERS = ("iteration", "seconds", "weight_change", "converged", "rows", "closes", "residual", "condition", "modelled")


def load(path: Path, device: str = "cpu", policy: bool = True) -> dict[str, Any]:
    """Load a run's checkpoint.

    Args:
        path: path of the file.
        device: device for its tensors.
        policy: whether it must contain a policy; a channel estimate is enough otherwise.

    Raises:
        CheckpointError: see `checkpoint.load`; or the file was not written by a run.
    """
    content = checkpoint.load(path, device)
    estimate = "actor" not in content and all(name in content for name in ESTIMATE)
    if policy and estimate:
        raise CheckpointError(f"{path}: holds a channel estimate and no policy; learn one with `uwirl init_from=...`")
    missing = [] if estimate else [name for name in NEEDED if name not in content]
    if missing:
        raise CheckpointError(f"{path}: lacks {', '.join(missing)}")
    return content


def history_of(records: Sequence[IterationRecord]) -> dict[str, Any]:
    """Records as plain data: a list of each number, critics [K, L, n2] and actors [K, L, n3]."""
    lists: dict[str, Any] = {name: [getattr(record, name) for record in records] for name in _NUMBERS}
    return lists | {name: torch.stack([getattr(record, name) for record in records]) for name in ("critic", "actor")}


def records_of(history: dict[str, Any]) -> list[IterationRecord]:
    """The records saved by `history_of`."""
    # Older checkpoints lack the last numbers.
    names = [name for name in (*_NUMBERS, "critic", "actor") if name in history]
    rows = zip(*(history[name] for name in names), strict=True)
    return [IterationRecord(**dict(zip(names, row, strict=True))) for row in rows]


def learner_of(state: LearningState) -> dict[str, Any]:
    """A learner's state as plain data, without its newest iterates, which are the last ones of its history."""
    learner, flight = state.learner, state.flight
    return {
        "flight": {"world": dict(flight.world._asdict()), "leg": flight.leg},
        "solver": dict(learner.solver._asdict()),
        "average_cost": learner.average_cost,
        "rows": learner.rows,
        "trim": state.trim,
        "start": state.start,
        "seconds": state.seconds,
        "contacts": state.contacts,
        "logs": [dict(log._asdict()) for log in state.logs],
        "known": None if state.known is None else dict(state.known._asdict()),
    }


def records_so_far(path: Path, content: dict[str, Any]) -> list[IterationRecord]:
    """Records of a learner that will continue.

    Raises:
        CheckpointError: the checkpoint contains only a policy.
    """
    if "learner" not in content:
        raise CheckpointError(f"{path}: holds a policy but no learner to continue; resume from last.pt")
    return records_of(content["history"])


def restore(learning: Learning, content: dict[str, Any]) -> LearningState:
    """The state saved by `learner_of`.

    Args:
        learning: the learning process to which the state belongs.
        content: content of the checkpoint.
    """
    saved, last = content["learner"], records_of(content["history"])[-1]
    solver = type(learning.iteration.solver.init(last.actor))(**saved["solver"])
    learner = LearnerState(
        solver, last.critic, last.actor, saved["average_cost"], saved["rows"], last.iteration, last.converged, ()
    )
    flight = FlightState(WorldState(**saved["flight"]["world"]), saved["flight"]["leg"])
    logs = tuple(Log(**log) for log in saved["logs"])
    known = None if saved["known"] is None else Identified(**saved["known"])
    seconds, contacts = saved["seconds"], saved["contacts"]
    return LearningState(flight, learner, saved["trim"], saved["start"], seconds, contacts, logs, known)


def policy_of(
    learning: Learning, state: LearningState, estimate: ChannelEstimate, record: IterationRecord
) -> dict[str, Any]:
    """One iterate as plain data: all that is needed to fly it, and what the `take_...` below take.

    Args:
        learning: that it comes from.
        state: of it.
        estimate: of the channel that it was learned for.
        record: of the iterate.
    """
    return {
        "iteration": record.iteration,
        "vehicle_seconds": record.seconds,
        "critic": record.critic,
        "actor": record.actor,
        "trim": state.trim,
        "model": dict(state.known._asdict()) if record.modelled and state.known else None,
        "features": features_of(learning.basis),
    } | estimate_of(estimate)


def estimate_of(estimate: ChannelEstimate) -> dict[str, Any]:
    """A channel estimate as plain data, with the part of the SNR that was known beforehand at some distances."""
    return {"estimate": estimate.state_dict(), "known_loss_dB": _known_loss(estimate.budget)}


def _known_loss(budget: LinkBudget) -> list[float]:
    return budget.known_loss_dB(torch.tensor(DISTANCES_M, dtype=torch.float64)).tolist()


def other_budget(path: Path, content: dict[str, Any], budget: LinkBudget) -> str | None:
    """What is wrong if the checkpoint's K and n were estimated with another link budget; None if nothing is."""
    # Older checkpoints lack it.
    ours = _known_loss(budget)
    for l, here, there in zip(DISTANCES_M, ours, content.get("known_loss_dB", ours), strict=True):
        if abs(here - there) > 1e-6:
            return (
                f"{path}: K and n were estimated with other noise and absorption ({there:.2f} dB at {l:g} m, here "
                f"{here:.2f} dB); choose the channel of its config.yaml: N0_dB, absorption, frequency_khz, water"
            )
    return None


def features_of(basis: Basis) -> dict[str, Any]:
    """Names of the features of a basis, which give its weights their meaning."""
    return {"critic": list(basis.critic_names), "actor": [list(names) for names in basis.actor_names]}


def take_estimate(path: Path, content: dict[str, Any], budget: LinkBudget, vehicles: int) -> ChannelEstimate:
    """The channel estimate of another run; an estimate of one vehicle is used for all vehicles.

    Args:
        path: path of the checkpoint, for messages.
        content: content of the checkpoint.
        budget: link budget of this run.
        vehicles: number of vehicles M.

    Raises:
        CheckpointError: it has estimates of several vehicles, but not of M.
    """
    estimate = ChannelEstimate.from_state(content["estimate"], budget)
    found = len(estimate.value)
    if found not in (1, vehicles):
        raise CheckpointError(
            f"{path}: channel estimates of {found} vehicles, shape {_shape(estimate.value)}; {vehicles} vehicles need "
            f"({vehicles}, 5) or (1, 5), which serves all"
        )
    return estimate if found == vehicles else ChannelEstimate.join([estimate] * vehicles)


def take_weights(path: Path, content: dict[str, Any], basis: Basis, learners: int) -> Tensor:
    """The actor's weights of another run, [L, n3]; one set is used for all learners.

    Args:
        path: path of the checkpoint, for messages.
        content: content of the checkpoint.
        basis: the basis for which the weights are used.
        learners: number of learners L.

    Raises:
        CheckpointError: the features differ, or there are several sets of weights, but not L.
    """
    theirs = [name for axis in content["features"]["actor"] for name in axis]
    ours = [name for axis in basis.actor_names for name in axis]
    if content["features"]["actor"] != features_of(basis)["actor"]:
        unknown, missing = sorted(set(theirs) - set(ours)), sorted(set(ours) - set(theirs))
        raise CheckpointError(
            f"{path}: {len(theirs)} weights of another basis, {len(ours)} are needed; only in the checkpoint: "
            f"{', '.join(unknown) or 'none'}; only here: {', '.join(missing) or 'none'}"
        )
    weights: Tensor = content["actor"]
    if len(weights) not in (1, learners):
        raise CheckpointError(
            f"{path}: actor weights {_shape(weights)}, where {_shape(weights.new_empty(learners, len(ours)))} or one "
            f"set for all, (1, {len(ours)}), are needed (experience=parallel learns one)"
        )
    return weights.expand(learners, -1).clone()


def take_trim(path: Path, content: dict[str, Any], learners: int) -> Tensor:
    """tau that holds a vehicle at rest, as learned in another run, [L, 4]."""
    trim: Tensor = content["trim"]
    if len(trim) not in (1, learners):
        raise CheckpointError(f"{path}: trim {_shape(trim)}, where ({learners}, 4) or (1, 4) is needed")
    return trim.expand(learners, -1).clone()


def _shape(tensor: Tensor) -> str:
    return str(tuple(tensor.shape))


def take_model(path: Path, content: dict[str, Any], names: Sequence[str]) -> Identified | None:
    """The model that a policy flies by; None where only what is declared of the vehicle was known.

    Raises:
        CheckpointError: its parameters are not those of the regressor, by their names.
    """
    saved = content["model"]
    if saved is None:
        return None
    if saved["theta"].shape != (len(names),):
        raise CheckpointError(f"{path}: model of {len(saved['theta'])} parameters, where there are {len(names)}")
    return Identified(**saved)
