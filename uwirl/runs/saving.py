"""Checkpoints of a run: those that it starts or continues from, and those that it saves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

import uwirl
from uwirl import build
from uwirl.algorithm import Estimated, Event, Improved, Planned, Start
from uwirl.config.schema import Config, InitPart
from uwirl.motion.learning import IterationRecord, Learning, LearningState
from uwirl.runs.interruption import Interruption
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study import checkpoint, run_files, run_folder
from uwirl.study.checkpoint import CheckpointError
from uwirl.study.learning_file import (
    history_of,
    learner_of,
    load,
    other_budget,
    policy_of,
    records_so_far,
    restore,
    take_estimate,
    take_weights,
)
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Origin:
    """The checkpoint with which a run starts, or none.

    Attributes:
        parts: parts taken from it: "estimate", "weights", or "everything" if the run is continued.
        path, content: path and content of the checkpoint.
    """

    parts: tuple[str, ...] = ()
    path: Path = Path()
    content: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, config: Config) -> Origin:
        """The origin of a configuration, by `resume` or `init_from`.

        Raises:
            CheckpointError: the checkpoint cannot be used.
        """
        place = config.resume or config.init_from
        if place is None:
            return cls()
        path = checkpoint.locate(Path(place))
        parts = ("estimate", "everything") if config.resume else tuple(map(str, config.init_from_parts))
        content = load(path, config.device, policy=config.resume is not None)
        if "actor" not in content:
            # A log tells of the channel alone.
            parts = tuple(part for part in parts if part == InitPart.estimate)
            if not parts:
                raise CheckpointError(
                    f"{path}: holds a channel estimate and no weights; give init_from_parts=[estimate]"
                )
        problem = other_budget(path, content, build.make_channel(config.channel).budget)
        if problem and InitPart.estimate in parts:
            raise CheckpointError(problem + (", or init_from_parts=[weights]" if "actor" in content else ""))
        return cls(parts, path, content)

    def config_hash(self, config: Config) -> str:
        """Hash of a run from here; the hash of the interrupted run if it is continued."""
        if "everything" in self.parts:
            return self.content["config_hash"]
        return run_folder.config_hash(config, checkpoint.digest(self.path) if self.content else None)

    def start(self, env: Relay) -> Start:
        """The parts, for Algorithm 1."""

        def weights(learning: Learning) -> Tensor:
            return take_weights(self.path, self.content, learning.basis, learning.learners)

        estimate = None
        if "estimate" in self.parts:
            estimate = take_estimate(self.path, self.content, env.budget, env.scenario.vehicles)
        return Start(
            estimate,
            weights if "weights" in self.parts else None,
            partial(restore, content=self.content) if "everything" in self.parts else None,
        )

    def records(self) -> list[IterationRecord]:
        """Records of continued learning; empty otherwise."""
        return records_so_far(self.path, self.content) if "everything" in self.parts else []


def unfinished(folder: Path, config_hash: str) -> Path | None:
    """The checkpoint of a run with this hash that was killed or interrupted in a folder; None if there is none."""
    path = folder / "checkpoints" / "last.pt"
    try:
        ended = run_folder.read_metrics(folder)["status"] != "interrupted"
    except (OSError, ValueError):
        ended = False
    try:
        return path if not ended and load(path)["config_hash"] == config_hash else None
    except CheckpointError:
        return None


class Checkpoints:
    """Listener that writes checkpoints/last.pt every few legs, at the end, and after a signal.

    Args:
        folder: folder of the run.
        config: its configuration.
        config_hash: hash of the configuration.
        overrides: overrides on the command line.
        records: records of a continued run.
        interruption: the signals received.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        config_hash: str,
        overrides: Sequence[str],
        records: list[IterationRecord],
        interruption: Interruption,
    ):
        self.folder, self.every = folder / "checkpoints", config.checkpoint.every
        self.records, self.interruption = records, interruption
        self.estimate: ChannelEstimate
        self.run = {
            "uwirl_version": uwirl.__version__,
            "config": asdict(config),
            "config_hash": config_hash,
            "overrides": list(overrides),
        }

    def __call__(self, event: Event) -> None:
        """Handle an event.

        Raises:
            Interrupted: a signal was received; everything learned has been saved.
        """
        match event:
            case Estimated(_, estimate):
                self.estimate = estimate
            case Improved(learning, state, records):
                self.records += records
                interrupted = self.interruption.number is not None
                if self.records and (interrupted or state.flight.leg % self.every == 0):
                    self.last(learning, state)
                self.interruption.check()
            case Planned(_, (learning, state)):
                self.last(learning, state)

    def last(self, learning: Learning, state: LearningState, metrics: dict[str, Any] | None = None) -> None:
        """Save the newest policy and the state from which learning can continue, and iterations.csv."""
        learner = {"learner": learner_of(state), "history": history_of(self.records), "metrics": metrics or {}}
        self._save("last.pt", policy_of(learning, state, self.estimate, self.records[-1]) | learner)
        run_files.write_iterations(self.folder.parent, self.records, (metrics or {}).get("cost_per_iteration", ()))

    def best(self, learning: Learning, state: LearningState, costs: Sequence[float | None]) -> None:
        """Save the policy with the lowest J of those flown again, which is not always the last one."""
        cost, k = min((cost, k) for k, cost in enumerate(costs) if cost is not None)
        self._save("best.pt", policy_of(learning, state, self.estimate, self.records[k]) | {"cost_total": cost})

    def _save(self, name: str, content: dict[str, Any]) -> None:
        checkpoint.save(self.folder / name, self.run | content)
