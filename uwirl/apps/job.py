"""One job, on its own or of a sweep: where it lies, whether it has been done before, what becomes of it."""

from __future__ import annotations

import hashlib
import logging
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from uwirl.apps.command_line import BAD_CONFIGURATION, say
from uwirl.config import compose
from uwirl.config.validate import ConfigError, validate

log = logging.getLogger("uwirl")

# File systems take 255.
MOST_BYTES = 200


def folder_name(overrides: str) -> str:
    """A job's folder below its sweep's: its overrides, or as much of them as a file system takes and a hash of all.

    Args:
        overrides: as Hydra joins them, sorted.
    """
    if not overrides:
        return "defaults"
    name = overrides.replace("/", "_").replace("\\", "_")
    if name == overrides and len(name.encode()) <= MOST_BYTES:
        return name
    digest = hashlib.sha256(overrides.encode()).hexdigest()[:12]
    return f"{name.encode()[: MOST_BYTES - 13].decode(errors='ignore')}_{digest}"


# At import, because another process of a sweep imports this module for `run_job` and nothing else before Hydra asks.
OmegaConf.register_new_resolver("job_folder", folder_name, replace=True)


def in_folder(program: str, work: Callable[[Path, bool], dict[str, Any]]) -> dict[str, Any]:
    """Do a job's work in the folder that Hydra has made for it, in which no other process is then.

    Args:
        program: its name.
        work: of the folder, and whether it is one of a sweep; returns what metrics.json holds.

    Returns:
        The same; only status and error if the folder of a sweep's job is not free.

    Raises:
        SystemExit: that of a single run is not free, or a signal came.
    """
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.runs.interruption import Interrupted
    from uwirl.study import run_folder

    job = HydraConfig.get()
    folder, sweep = Path(job.runtime.output_dir), job.mode is RunMode.MULTIRUN
    try:
        with run_folder.held(folder):
            return work(folder, sweep)
    except run_folder.FolderError as error:
        say(program, error)
        if not sweep:
            sys.exit(BAD_CONFIGURATION)
        return {"status": "failed", "error": str(error)}
    except Interrupted as interrupted:
        # Not only this job: who interrupts a sweep wants it to end.
        sys.exit(interrupted.exit_code)


def run_job(composed: DictConfig) -> dict[str, Any]:
    """Run what Hydra composed, unless it is a sweep's and has been done before; see `in_folder`."""
    return in_folder("uwirl", lambda folder, sweep: _run(composed, folder, sweep))


def _run(composed: DictConfig, folder: Path, sweep: bool) -> dict[str, Any]:
    from uwirl.runs.refusal import write_refusal
    from uwirl.runs.run import run
    from uwirl.runs.saving import Origin, unfinished
    from uwirl.study import run_folder
    from uwirl.study.checkpoint import CheckpointError

    job = HydraConfig.get()
    overrides = [text for text in job.overrides.task if not text.startswith("resume=")]
    experiment = str(job.runtime.choices["experiment"])
    config = None
    try:
        config = compose.to_config(composed)
        compose.check_composed(composed, job.runtime.choices, GlobalHydra.instance().config_loader())
        validate(config)
        if config.resume is not None and sweep:
            raise ConfigError("resume", "continues one run at a time, as in `uwirl resume=PATH`")
        config_hash = Origin.of(config).config_hash(replace(config, resume=None))
    except (ConfigError, CheckpointError) as error:
        # One command line was checked before, so this is a job of a sweep.
        say("uwirl", error)
        return write_refusal(folder, experiment, overrides, config, error)
    if sweep:
        if run_folder.is_complete(folder, config_hash):
            log.info("skipped: complete, in %s", folder)
            return run_folder.read_metrics(folder)
        left = unfinished(folder, config_hash)
        config = replace(config, resume=None if left is None else str(left))
    home = config.resume is not None and Path(config.resume).resolve().parent.parent == folder.resolve()
    if not sweep and not home:
        run_folder.check_free(folder, config)
    if config.resume is None:
        run_folder.clear(folder)
    return run(config, experiment, folder, overrides)
