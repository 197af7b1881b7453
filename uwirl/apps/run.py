"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uwirl.apps.command_line import BAD_CONFIGURATION, FAILED, one_line
from uwirl.config import compose
from uwirl.config.schema import register
from uwirl.config.validate import ConfigError, validate


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if the run failed."""
    register()
    arguments = sys.argv[1:]
    # Hydra's own flags (--help, --multirun, ...) may take what compose would refuse, so they go straight to Hydra.
    if not any(argument.startswith("-") for argument in arguments):
        sys.argv[1:] = _checked(arguments)
    failures: list[str] = []

    @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="config")
    def job(composed: DictConfig) -> None:
        # Imported here so that a bad configuration is answered before torch is loaded.
        from uwirl.apps.algorithm import run
        from uwirl.apps.interruption import Interrupted

        settings = HydraConfig.get()
        try:
            config = compose.to_config(composed)
            validate(config)
            if config.resume is not None and settings.mode == RunMode.MULTIRUN:
                raise ConfigError("resume", "continues one run at a time, as in `uwirl resume=PATH`")
        except (ConfigError, OmegaConfBaseException) as error:
            print(f"uwirl: {one_line(error)}", file=sys.stderr)
            failures.append(str(error))
            return
        overrides = [text for text in settings.overrides.task if not text.startswith("resume=")]
        try:
            metrics = run(config, settings.runtime.choices["experiment"], Path(settings.runtime.output_dir), overrides)
        except Interrupted as interrupted:
            # Not only this job: who interrupts a sweep wants it to end.
            sys.exit(interrupted.exit_code)
        if metrics["status"] != "complete":
            failures.append(metrics["error"])

    job()
    if failures:
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
