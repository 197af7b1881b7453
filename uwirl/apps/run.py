"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from omegaconf import DictConfig

from uwirl.apps.command_line import FAILED, answer, failed_jobs, note_failure, one_message
from uwirl.apps.job import run_job
from uwirl.config import compose
from uwirl.config.schema import register
from uwirl.config.validate import validate


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if a run failed."""
    register()
    answer("uwirl", "config", _check)
    with one_message("uwirl"), failed_jobs() as failures:

        @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="config")
        def job(composed: DictConfig) -> float | None:
            # Written first, so that a job that raises, which a search would go on after, has failed too.
            note = note_failure(failures)
            metrics = run_job(composed)
            if metrics["status"] != "complete":
                return None
            note.unlink()
            # What a sweeper that searches makes small.
            return metrics.get("cost_total")

        job()
        failed = any(failures.iterdir())
    if failed:
        sys.exit(FAILED)


def _check(composed: DictConfig) -> None:
    """Refuse what cannot be run; a run that is resumed gets the command line that it began with."""
    config = compose.to_config(composed)
    validate(config)
    if config.resume is None and config.init_from is None:
        return
    # These need torch, which reads checkpoints.
    from uwirl.apps.continuation import continued
    from uwirl.study import checkpoint, learning_file

    if config.resume is not None:
        sys.argv[1:] = continued(sys.argv[1:], config)
    else:
        learning_file.load(checkpoint.locate(Path(config.init_from or "")))


if __name__ == "__main__":
    main()
