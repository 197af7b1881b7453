"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
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
        _check(arguments)
    failures: list[str] = []

    @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="config")
    def job(composed: DictConfig) -> None:
        # Imported here so that a bad configuration is answered before torch is loaded.
        from uwirl.apps.algorithm import run

        runtime = HydraConfig.get().runtime
        try:
            config = compose.to_config(composed)
            validate(config)
        except (ConfigError, OmegaConfBaseException) as error:
            print(f"uwirl: {one_line(error)}", file=sys.stderr)
            failures.append(str(error))
            return
        metrics = run(config, runtime.choices["experiment"], Path(runtime.output_dir))
        if metrics["status"] != "complete":
            failures.append(metrics["error"])

    job()
    if failures:
        sys.exit(FAILED)


def _check(overrides: list[str]) -> None:
    try:
        validate(compose.compose(overrides))
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        print(f"uwirl: {one_line(error)}", file=sys.stderr)
        sys.exit(BAD_CONFIGURATION)


if __name__ == "__main__":
    main()
