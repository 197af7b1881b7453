"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import argparse
import logging
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from uwirl.apps import job
from uwirl.apps.command_line import answering, checked, launch
from uwirl.apps.job import Job
from uwirl.config import compose
from uwirl.config.schema import Config, register
from uwirl.config.validate import ConfigError, validate

log = logging.getLogger("uwirl")


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if a run failed."""
    register()
    with answering("uwirl"):
        sys.argv[1:] = checked("uwirl", "config", sys.argv[1:], _check)
    launch("uwirl", "config", run_job)


def _check(composed: DictConfig, flags: argparse.Namespace) -> list[str]:
    """Refuse what cannot be run; a run that is resumed gets the command line that it began with."""
    config = compose.to_config(composed)
    validate(config)
    if config.resume is None and config.init_from is None:
        return flags.overrides
    # These need torch, which reads checkpoints.
    from uwirl.apps.continuation import continued
    from uwirl.study import checkpoint, learning_file

    if config.resume is not None:
        return continued(flags.overrides, config, flags.config_dir)
    learning_file.load(checkpoint.locate(Path(config.init_from or "")))
    return flags.overrides


def run_job(composed: DictConfig) -> dict[str, Any]:
    """Run what Hydra composed, unless it is a sweep's and has been done before."""
    return job.run_job("uwirl", composed, _prepare, _run)


def _prepare(config: Config, job: Job) -> tuple[Config, str]:
    from uwirl.runs.saving import Origin

    validate(config)
    if config.resume is not None and job.sweep:
        raise ConfigError("resume", "continues one run at a time, as in `uwirl resume=PATH`")
    return config, Origin.of(config).config_hash(replace(config, resume=None))


def _run(ready: tuple[Config, str], job: Job) -> dict[str, Any]:
    from uwirl.runs.algorithm import run
    from uwirl.runs.saving import unfinished
    from uwirl.study import run_folder

    (config, config_hash), folder = ready, job.folder
    if job.sweep:
        if run_folder.is_complete(folder, config_hash):
            log.info("skipped: complete, in %s", folder)
            return run_folder.read_metrics(folder)
        left = unfinished(folder, config_hash)
        config = replace(config, resume=None if left is None else str(left))
    home = config.resume is not None and Path(config.resume).resolve().parent.parent == folder.resolve()
    if not job.sweep and not home:
        run_folder.check_free(folder, config)
    if config.resume is None:
        run_folder.clear(folder)
    return run(config, job.experiment, folder, job.overrides)


if __name__ == "__main__":
    main()
