"""A run's checkpoints: what it continues or starts from, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

import uwirl
from uwirl.algorithm import Start
from uwirl.config.schema import Config
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.runs.interruption import INTERRUPTED
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study import checkpoint, run_folder
from uwirl.study.checkpoint import CheckpointError
from uwirl.study.learning_file import (
    features_of,
    history_of,
    learner_of,
    load,
    records_so_far,
    restore,
    take_estimate,
    take_weights,
)
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Origin:
    """Where a run starts from: from nothing, from another run's results, or where a run was interrupted.

    Attributes:
        parts: what is taken over: estimate, weights, or everything.
        path, content: of the checkpoint.
    """

    parts: tuple[str, ...] = ()
    path: Path = Path()
    content: dict[str, Any] | None = None

    @classmethod
    def of(cls, config: Config) -> Origin:
        """Raises CheckpointError if the checkpoint cannot be used."""
        place = config.resume or config.init_from
        if place is None:
            return cls()
        path = checkpoint.locate(Path(place))
        parts = ("estimate", "everything") if config.resume else tuple(config.init_from_parts)
        return cls(parts, path, load(path, config.device))

    def config_hash(self, config: Config) -> str:
        """Of a run from here; that of the interrupted one if it is continued."""
        if self.content is None:
            return run_folder.config_hash(config)
        if "everything" in self.parts:
            return self.content["config_hash"]
        return run_folder.config_hash(config, checkpoint.digest(self.path))

    def start(self, env: Relay) -> Start:
        """What Algorithm 1 takes over."""
        content, path = self.content, self.path
        if content is None:
            return Start()
        estimate = weights = state = None
        if "estimate" in self.parts:
            estimate = take_estimate(path, content, env.budget, env.scenario.vehicles)
        if "weights" in self.parts:
            weights = partial(_weights, path, content)
        if "everything" in self.parts:
            state = partial(restore, content=content)
        return Start(estimate, weights, state)

    def records(self) -> list[IterationRecord]:
        """Of the learning that is continued, if any is."""
        if self.content is None or "everything" not in self.parts:
            return []
        return records_so_far(self.path, self.content)


def _weights(path: Path, content: dict[str, Any], learning: Learning) -> Tensor:
    return take_weights(path, content, learning.basis, learning.learners)


def unfinished(folder: Path, config_hash: str) -> Path | None:
    """The checkpoint of a run with this hash that was killed or interrupted in a folder; None where none was."""
    path = folder / "checkpoints" / "last.pt"
    try:
        ended = not str(run_folder.read_metrics(folder).get("error")).startswith(INTERRUPTED)
    except (OSError, ValueError):
        ended = False
    try:
        return path if not ended and load(path)["config_hash"] == config_hash else None
    except CheckpointError:
        return None


class Checkpoints:
    """Writes checkpoints/last.pt and best.pt.

    Args:
        folder: of the run.
        config: its settings.
        config_hash: of them.
        overrides: the command line that composes them.
    """

    def __init__(self, folder: Path, config: Config, config_hash: str, overrides: Sequence[str]):
        self.folder = folder / "checkpoints"
        self.every = config.checkpoint.every
        self.run = {
            "uwirl_version": uwirl.__version__,
            "config": asdict(config),
            "config_hash": config_hash,
            "overrides": list(overrides),
        }

    def last(
        self,
        learning: Learning,
        state: LearningState,
        estimate: ChannelEstimate,
        records: Sequence[IterationRecord],
        metrics: dict[str, Any] | None = None,
    ) -> None:
        """The newest policy, and all that is needed to go on learning."""
        learner = {"learner": learner_of(state), "history": history_of(records)}
        content = self._policy(learning, state, estimate, records[-1]) | learner | {"metrics": metrics or {}}
        checkpoint.save(self.folder / "last.pt", content)

    def best(
        self,
        learning: Learning,
        state: LearningState,
        estimate: ChannelEstimate,
        records: Sequence[IterationRecord],
        costs: Sequence[float],
    ) -> None:
        """The policy of the lowest of its missions' costs J, which learning need not end with."""
        k = min(range(len(costs)), key=costs.__getitem__)
        content = self._policy(learning, state, estimate, records[k]) | {"cost_total": costs[k]}
        checkpoint.save(self.folder / "best.pt", content)

    def _policy(
        self, learning: Learning, state: LearningState, estimate: ChannelEstimate, record: IterationRecord
    ) -> dict[str, Any]:
        return self.run | {
            "iteration": record.iteration,
            "vehicle_seconds": record.seconds,
            "critic": record.critic,
            "actor": record.actor,
            "trim": state.trim,
            "features": features_of(learning.basis),
            "estimate": estimate.state_dict(),
        }
