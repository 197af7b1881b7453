"""Files of a run: config.yaml, metrics.json, arrays; and which run a folder belongs to."""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.overrides import FREE
from uwirl.config.schema import Config
from uwirl.study.atomic_io import read_whole, write_whole

log = logging.getLogger("uwirl")

# Largest size of metrics.json, which has 3 kB, or a few MB with the costs of many iterations.
MOST_BYTES = 10**8

STATUSES = ("complete", "failed", "interrupted")
# Files that a run writes in addition to config.yaml and run.log.
RESULTS = (
    "metrics.json",
    "iterations.csv",
    "trajectory.npz",
    "layouts.npz",
    "estimate.npz",
    "checkpoints",
    "figures",
    "tb",
)


class FolderError(ValueError):
    """A folder that this run must not write into; the message names it."""


def config_hash(config: Config | EstimateConfig, start: str | None = None) -> str:
    """Hash of all settings that change the result: not of logging, checkpoints and paths.

    Args:
        config: the settings.
        start: digest of the checkpoint from which a run starts.
    """
    relevant = _relevant(asdict(config))
    if "init_from" in relevant:
        relevant["init_from"] = start
    return hashlib.sha256(json.dumps(relevant, sort_keys=True).encode()).hexdigest()[:16]


def write_config(folder: Path, config: Config | EstimateConfig) -> None:
    """Write the resolved configuration to config.yaml."""
    write_whole(folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(asdict(config))).encode())


def write_metrics(folder: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json, one flat object, atomically. Infinite values and NaN become null: JSON has neither."""
    write_whole(folder / "metrics.json", (json.dumps(_finite(metrics), indent=2) + "\n").encode())


def close(folder: Path, metrics: dict[str, Any]) -> None:
    """Write the metrics of a run that has ended; if they cannot be written, the run has failed."""
    try:
        write_metrics(folder, metrics)
    except OSError as error:
        log.error("failed: %s", error)
        metrics |= {"status": "failed", "error": metrics["error"] or f"{type(error).__name__}: {error}"}


def read_metrics(folder: Path) -> dict[str, Any]:
    """Content of metrics.json.

    Raises:
        OSError: the file is missing or cannot be read.
        ValueError: the content was not written by a run.
    """
    try:
        metrics = json.loads(read_whole(folder / "metrics.json", MOST_BYTES))
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(metrics, dict) or metrics.get("status") not in STATUSES:
        raise ValueError(f"not the metrics of a run: no object with a status of {', '.join(STATUSES)}")
    return metrics


def is_complete(folder: Path, config_hash: str) -> bool:
    """Whether a folder contains the results of the configuration with this hash."""
    try:
        metrics = read_metrics(folder)
    except (OSError, ValueError):
        return False
    return metrics["status"] == "complete" and metrics.get("config_hash") == config_hash


def has_results(folder: Path) -> bool:
    """Whether a folder contains results of a run, complete or not."""
    try:
        complete = read_metrics(folder)["status"] == "complete"
    except (OSError, ValueError):
        complete = False
    return complete or any((folder / name).exists() for name in RESULTS if name not in ("metrics.json", "tb"))


def _relevant(settings: Mapping[Any, Any]) -> dict[str, Any]:
    """The settings that change the result."""
    return {str(key): value for key, value in settings.items() if key not in FREE}


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes; the lock ends with this process, however it ends.

    Raises:
        FolderError: another process has locked it.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    with (folder / "run.log").open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FolderError(f"{folder}: another process is running in it; wait for it, or choose another") from None
        except OSError:
            # The file system has no locks: then users must not start two runs in the same folder.
            pass
        yield


def check_free(folder: Path, config: Config | EstimateConfig) -> None:
    """Raise FolderError if the folder contains a run with another configuration or with unknown settings."""
    path = folder / "config.yaml"
    if not path.exists():
        # The scripts in experiments/ write no settings.
        if (folder / "metrics.json").exists():
            raise _another(folder)
        return
    try:
        settings = OmegaConf.to_container(OmegaConf.load(path))
    except Exception:
        # A damaged file does not count as this configuration.
        settings = None
    if not isinstance(settings, dict) or _relevant(settings) != _relevant(asdict(config)):
        raise _another(folder)


def check_own(folder: Path, config_hash: str) -> None:
    """Raise FolderError if the folder contains a run that is not certainly the one with this hash."""
    if not any((folder / name).exists() for name in ("config.yaml", "metrics.json")):
        return
    try:
        own = read_metrics(folder).get("config_hash") == config_hash
    except (OSError, ValueError):
        own = False
    if not own:
        raise _another(folder)


def _another(folder: Path) -> FolderError:
    return FolderError(f"hydra.run.dir: {folder} holds another run, and is left as it is")


def clear(folder: Path) -> None:
    """Remove the files of an earlier run, so that they are not taken for the next one's; only in run folders."""
    # The folder may contain other files of the user: hydra.run.dir=. is allowed.
    traces = (folder / "config.yaml", folder / "metrics.json")
    if not any(path.is_file() and path.stat().st_size for path in traces):
        return
    for name in RESULTS:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
