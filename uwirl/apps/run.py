"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uwirl.apps.command_line import FAILED, answer, say
from uwirl.config import compose
from uwirl.config.schema import register
from uwirl.config.validate import ConfigError, validate


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if the run failed."""
    register()
    answer("uwirl", "config", lambda composed: validate(compose.to_config(composed)))
    failures: list[str] = []

    @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name="config")
    def job(composed: DictConfig) -> None:
        error = _job(composed)
        if error:
            failures.append(error)

    job()
    if failures:
        sys.exit(FAILED)


def _job(composed: DictConfig) -> str | None:
    """Run one job in its folder; what it failed of, or None."""
    runtime = HydraConfig.get().runtime
    experiment, folder = str(runtime.choices["experiment"]), Path(runtime.output_dir)
    config = None
    try:
        config = compose.to_config(composed)
        compose.check_composed(composed, runtime.choices, GlobalHydra.instance().config_loader())
        validate(config)
    except ConfigError as error:
        # One command line was checked before, so this is a job of a multirun.
        from uwirl.apps.refusal import write_refusal

        say("uwirl", error)
        write_refusal(folder, experiment, config, error)
        return str(error)
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.apps.algorithm import run

    return run(config, experiment, folder)["error"]


if __name__ == "__main__":
    main()
