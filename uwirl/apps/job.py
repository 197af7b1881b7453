"""One job, on its own or of a sweep: where it lies, whether it has been done before, what becomes of it."""

from __future__ import annotations

import hashlib
import logging
import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import uwirl
from uwirl.apps.command_line import BAD_CONFIGURATION, one_line
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


def run_job(composed: DictConfig) -> bool:
    """Run what Hydra composed, unless it is a sweep's and has been done before; returns whether it is complete.

    Raises:
        SystemExit: the folder of a single run is that of another one.
    """
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.apps.algorithm import run
    from uwirl.study import run_folder

    job = HydraConfig.get()
    folder, overrides = Path(job.runtime.output_dir), list(job.overrides.task)
    experiment = job.runtime.choices["experiment"]
    try:
        config = compose.to_config(composed)
        validate(config)
    except (ConfigError, OmegaConfBaseException) as error:
        print(f"uwirl: {one_line(error)}", file=sys.stderr)
        told = f"{type(error).__name__}: {one_line(error)}"
        run_folder.clear(folder)
        run_folder.write_metrics(
            folder,
            {
                "status": "failed",
                "error": told,
                "experiment": experiment,
                "overrides": overrides,
                "uwirl_version": uwirl.__version__,
            },
        )
        return False
    if job.mode is RunMode.MULTIRUN and run_folder.is_complete(folder, config):
        log.info("skipped: complete, in %s", folder)
        return True
    if job.mode is RunMode.RUN and not run_folder.claim(folder, config):
        print(f"uwirl: hydra.run.dir: {folder} holds another run, and is left as it is", file=sys.stderr)
        sys.exit(BAD_CONFIGURATION)
    run_folder.clear(folder)
    return run(config, experiment, folder, overrides)["status"] == "complete"
