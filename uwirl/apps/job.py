"""One job, on its own or of a sweep: where it lies, and what becomes of settings that cannot be run."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from uwirl.apps.command_line import BAD_CONFIGURATION, say
from uwirl.config import compose
from uwirl.config.groups import Groups

# File systems take 255.
MOST_BYTES = 200
Ready = TypeVar("Ready")


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


# At import, because another process of a sweep imports this module for its job and nothing else before Hydra asks.
OmegaConf.register_new_resolver("job_folder", folder_name, replace=True)


@dataclass(frozen=True)
class Job:
    """Where Hydra runs what.

    Attributes:
        folder: the job's, in which no other process is.
        sweep: whether it is one of several.
        experiment: its name.
        overrides: that compose its settings.
    """

    folder: Path
    sweep: bool
    experiment: str
    overrides: list[str]

    @classmethod
    def current(cls) -> Job:
        hydra = HydraConfig.get()
        experiment = str(hydra.runtime.choices.get("experiment", hydra.job.config_name))
        overrides = [text for text in hydra.overrides.task if not text.startswith("resume=")]
        return cls(Path(hydra.runtime.output_dir), hydra.mode is RunMode.MULTIRUN, experiment, overrides)


def run_job(
    program: str,
    composed: DictConfig,
    prepare: Callable[[Any, Job], Ready],
    work: Callable[[Ready, Job], dict[str, Any]],
) -> dict[str, Any]:
    """Do what Hydra composed, in the folder that Hydra has made for it.

    Args:
        program: its name.
        composed: the settings.
        prepare: from typed settings to what can be run; raises ValueError or OSError if they cannot.
        work: runs it; returns what metrics.json holds.

    Returns:
        The same; only status and error if the folder of a sweep's job is not free.

    Raises:
        SystemExit: that of a single run is not free, or a signal came.
    """
    # Imported here so that a bad configuration is answered before torch is loaded.
    from uwirl.runs.interruption import Interrupted
    from uwirl.runs.refusal import write_refusal
    from uwirl.study import run_folder

    job, config = Job.current(), None
    try:
        with run_folder.held(job.folder):
            try:
                config = compose.to_object(composed)
                hydra = HydraConfig.get()
                groups = Groups(GlobalHydra.instance().config_loader(), str(hydra.job.config_name))
                compose.check_composed(composed, hydra.runtime.choices, groups)
                ready = prepare(config, job)
            except (ValueError, OSError) as error:
                # One command line was checked before, so this is a job of a sweep.
                say(program, error)
                return write_refusal(job.folder, job.experiment, job.overrides, config, error)
            return work(ready, job)
    except run_folder.FolderError as error:
        say(program, error)
        if not job.sweep:
            sys.exit(BAD_CONFIGURATION)
        return {"status": "failed", "error": str(error)}
    except Interrupted as interrupted:
        # Not only this job: who interrupts a sweep wants it to end.
        sys.exit(interrupted.exit_code)
