"""`uwirl-estimate data=readings.csv`: the channel behind a log of readings, how far to trust it, and a map."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from uwirl.apps.command_line import BAD_CONFIGURATION, FAILED, failed_jobs, note_failure, one_line
from uwirl.config import compose
from uwirl.config.estimate_rules import validate_estimate
from uwirl.config.estimate_schema import EstimateConfig, register

if TYPE_CHECKING:
    from uwirl.apps.survey import Survey


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration or log; 1 if the run failed."""
    register()
    arguments = sys.argv[1:]
    checked: list[Survey] = []
    # Hydra's own flags (--help, --multirun, ...) may take what compose would refuse, so they go straight to Hydra.
    if not any(argument.startswith("-") for argument in arguments):
        try:
            checked.append(_prepare(compose.composed("estimate", arguments)))
        except (HydraException, OmegaConfBaseException, ValueError, OSError) as error:
            print(f"uwirl-estimate: {one_line(error)}", file=sys.stderr)
            sys.exit(BAD_CONFIGURATION)
    with failed_jobs() as failures:

        @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="estimate")
        def job(composed: DictConfig) -> None:
            from uwirl.apps.survey import run

            try:
                survey = checked.pop() if checked else _prepare(composed)
            except (OmegaConfBaseException, ValueError, OSError) as error:
                print(f"uwirl-estimate: {one_line(error)}", file=sys.stderr)
                note_failure(failures)
                return
            if run(survey, Path(HydraConfig.get().runtime.output_dir))["status"] != "complete":
                note_failure(failures)

        job()
        failed = any(failures.iterdir())
    if failed:
        sys.exit(FAILED)


def _prepare(composed: DictConfig) -> Survey:
    """All that can be wrong with settings and log, found before a run folder is made.

    Raises:
        ValueError, OSError, OmegaConfBaseException: with what is wrong.
    """
    config = OmegaConf.to_object(composed)
    assert isinstance(config, EstimateConfig)
    validate_estimate(config)
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.apps.survey import Survey

    return Survey.of(config)


if __name__ == "__main__":
    main()
