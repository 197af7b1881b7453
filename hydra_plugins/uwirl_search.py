"""Optuna's search with several seeds a trial, found by Hydra because it stands in the package `hydra_plugins`.

Of the optuna sweeper nothing is imported before a search begins: Hydra reads this file at every start.
"""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Sequence
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig

log = logging.getLogger("uwirl")


class Search(Sweeper):
    """`hydra/sweeper=search` and the spaces built on it.

    Args:
        seeds: of the jobs of each trial; their mean is what is made small.
        optuna: what its own sweeper takes.
    """

    def __init__(self, seeds: Sequence[int], **optuna: Any):
        from hydra_plugins.hydra_optuna_sweeper._impl import OptunaSweeperImpl

        self.seeds = list(seeds)
        # No database: the same command again draws the same trials, whose jobs are complete. No failure ends it.
        fixed = {"storage": None, "study_name": None, "search_space": None, "custom_search_space": None}
        self.optuna = OptunaSweeperImpl(**optuna, **fixed, max_failure_rate=1.0)

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Hydra's, once before `sweep`."""
        self.optuna.setup(hydra_context=hydra_context, task_function=task_function, config=config)
        self.trials = Trials(self.optuna.launcher, self.seeds)
        self.optuna.launcher = self.trials

    def sweep(self, arguments: list[str]) -> None:
        """Search; ends with exit code 1 where no trial succeeded, for then none is the best."""
        try:
            self.optuna.sweep(arguments)
        except ValueError as error:
            if self.trials.succeeded:
                raise
            if not self.trials.launched:
                # A space that optuna cannot draw from.
                sys.exit(f"uwirl: hydra.sweeper: {error}")
            sys.exit("uwirl: hydra/sweeper: no trial has a J (cost_total) with every seed, so none is the best")


class Trials:
    """A launcher whose jobs are trials: each is handed on as one job a seed, and returns the mean.

    Args:
        launcher: that runs the jobs.
        seeds: of each trial.
    """

    def __init__(self, launcher: Launcher, seeds: Sequence[int]):
        self.launcher = launcher
        self.seeds = seeds
        self.launched = self.succeeded = 0

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
        """One return for each trial, None where a seed failed: a mean over the others would praise what fails."""
        n = len(self.seeds)
        jobs = [[*trial, f"seed={seed}"] for trial in job_overrides for seed in self.seeds]
        returns = self.launcher.launch(jobs, initial_job_idx=n * initial_job_idx)
        values = [value_of(job) for job in returns]
        means = [mean(values[i : i + n]) for i in range(0, len(values), n)]
        self.launched += len(means)
        self.succeeded += sum(value is not None and math.isfinite(value) for value in means)
        return [
            JobReturn(overrides=list(trial), status=JobStatus.COMPLETED, _return_value=value)
            for trial, value in zip(job_overrides, means, strict=True)
        ]


def value_of(job: JobReturn) -> float | None:
    """What a job returned, or None after an exception, which Hydra keeps to itself unless it is asked."""
    if job.status is JobStatus.COMPLETED:
        return job._return_value
    log.error("failed: %r, in %s", job._return_value, " ".join(job.overrides or []))
    return None


def mean(values: Sequence[float | None]) -> float | None:
    """Of all, or None if one is missing."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None
