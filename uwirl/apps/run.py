"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uwirl.apps.command_line import BAD_CONFIGURATION, FAILED, failed_jobs, note_failure, one_line
from uwirl.apps.job import run_job
from uwirl.config import compose
from uwirl.config.schema import register
from uwirl.config.validate import validate


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if a run failed."""
    register()
    arguments = sys.argv[1:]
    # Hydra's own flags (--help, --multirun, ...) may take what compose would refuse, so they go straight to Hydra.
    if not any(argument.startswith("-") for argument in arguments):
        sys.argv[1:] = _checked(arguments)
    with failed_jobs() as failures:

        @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="config")
        def job(composed: DictConfig) -> None:
            if not run_job(composed):
                note_failure(failures)

        job()
        failed = any(failures.iterdir())
    if failed:
        sys.exit(FAILED)


def _checked(arguments: list[str]) -> list[str]:
    """The command line, or the one of the run that it resumes, once nothing is wrong with it."""
    try:
        config = compose.compose(arguments)
        validate(config)
        if config.resume is None and config.init_from is None:
            return arguments
        # These need torch, which reads checkpoints.
        from uwirl.apps.continuation import continued
        from uwirl.study import checkpoint, learning_file

        if config.resume is not None:
            return continued(arguments, config)
        learning_file.load(checkpoint.locate(Path(config.init_from or "")))
        return arguments
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        print(f"uwirl: {one_line(error)}", file=sys.stderr)
        sys.exit(BAD_CONFIGURATION)


if __name__ == "__main__":
    main()
