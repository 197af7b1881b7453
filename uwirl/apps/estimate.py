"""`uwirl-estimate data=readings.csv`: the channel behind a log of readings, how far to trust it, and a map."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from uwirl.apps.command_line import answering, checked, launch
from uwirl.apps.job import Job, run_job
from uwirl.config import compose
from uwirl.config.estimate_schema import EstimateConfig, register
from uwirl.config.validate import validate_estimate

if TYPE_CHECKING:
    from uwirl.runs.survey import Survey

PROGRAM = "uwirl-estimate"


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration or log; 1 if the run failed."""
    register()
    # The log, which the job need not read again.
    read: list[Survey] = []

    def check(composed: DictConfig, flags: argparse.Namespace) -> list[str]:
        read.append(_survey(compose.to_object(composed)))
        return flags.overrides

    with answering(PROGRAM):
        sys.argv[1:] = checked(PROGRAM, "estimate", sys.argv[1:], check)
    launch(
        PROGRAM,
        "estimate",
        lambda composed: run_job(PROGRAM, composed, lambda config, job: read.pop() if read else _survey(config), _run),
    )


def _survey(config: EstimateConfig) -> Survey:
    """All that can be wrong with settings and log, found before a run folder is made.

    Raises:
        ValueError, OSError: with what is wrong.
    """
    validate_estimate(config)
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.runs.survey import Survey

    return Survey.of(config)


def _run(survey: Survey, job: Job) -> dict[str, Any]:
    from uwirl.runs.survey import run
    from uwirl.study import run_folder

    if not job.sweep:
        run_folder.check_free(job.folder, survey.config)
    return run(survey, job.folder)


if __name__ == "__main__":
    main()
