"""`uwirl-estimate data=readings.csv`: the channel behind a log of readings, how far to trust it, and a map."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from uwirl.apps.command_line import BAD_CONFIGURATION, FAILED, answer, failed_jobs, note_failure, one_message, say
from uwirl.config import compose
from uwirl.config.estimate_rules import validate_estimate
from uwirl.config.estimate_schema import EstimateConfig, register
from uwirl.config.suggestions import check_known

if TYPE_CHECKING:
    from uwirl.apps.survey import Survey


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration or log; 1 if the run failed."""
    register()
    checked: list[Survey] = []
    answer("uwirl-estimate", "estimate", lambda composed: checked.append(_prepare(_typed(composed))))
    with one_message("uwirl-estimate"), failed_jobs() as failures:

        @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="estimate")
        def job(composed: DictConfig) -> None:
            if _job(composed, checked):
                note_failure(failures)

        job()
        failed = any(failures.iterdir())
    if failed:
        sys.exit(FAILED)


def _job(composed: DictConfig, checked: list[Survey]) -> str | None:
    """Run one job in its folder, on a log that may have been read already; what it failed of, or None."""
    from uwirl.apps.interruption import Interrupted
    from uwirl.apps.survey import run
    from uwirl.study import run_folder

    job = HydraConfig.get()
    folder, sweep = Path(job.runtime.output_dir), job.mode is RunMode.MULTIRUN
    config = None
    try:
        if not checked:
            check_known(composed)
            config = _typed(composed)
        survey = checked.pop() if config is None else _prepare(config)
    except (ValueError, OSError) as error:
        from uwirl.apps.refusal import write_refusal

        say("uwirl-estimate", error)
        write_refusal(folder, "estimate", list(job.overrides.task), config, error)
        return str(error)
    try:
        with run_folder.held(folder):
            if not sweep:
                run_folder.check_free(folder, survey.config)
            return run(survey, folder)["error"]
    except Interrupted as interrupted:
        # Not only this job: who interrupts a sweep wants it to end.
        sys.exit(interrupted.exit_code)
    except run_folder.FolderError as error:
        say("uwirl-estimate", error)
        if not sweep:
            sys.exit(BAD_CONFIGURATION)
        return str(error)


def _typed(composed: DictConfig) -> EstimateConfig:
    config = compose.to_object(composed)
    assert isinstance(config, EstimateConfig)
    return config


def _prepare(config: EstimateConfig) -> Survey:
    """All that can be wrong with settings and log, found before a run folder is made.

    Raises:
        ValueError, OSError: with what is wrong.
    """
    validate_estimate(config)
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.apps.survey import Survey

    return Survey.of(config)


if __name__ == "__main__":
    main()
