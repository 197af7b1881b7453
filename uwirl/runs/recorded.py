"""What metrics.json says of every run whatever becomes of it: the time it took, and how it ended."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import uwirl
from uwirl.config.checks import ConfigError
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.overrides import effective
from uwirl.config.schema import Config
from uwirl.irl.policy_iteration import InadmissiblePolicyError, InsufficientDataError
from uwirl.motion.targets import NoTargetError
from uwirl.runs.interruption import Interrupted, Interruption
from uwirl.snr.model import UnidentifiableError
from uwirl.study import run_folder
from uwirl.study.checkpoint import CheckpointError
from uwirl.world.trajectory import DivergedError

log = logging.getLogger("uwirl")

# What a run may end in without being a bug: its message goes into metrics.json.
FAILURES = (
    CheckpointError,
    ConfigError,  # an object of the user's own lacks something
    DivergedError,
    InadmissiblePolicyError,
    InsufficientDataError,
    UnidentifiableError,
    NoTargetError,
    ArithmeticError,
    OSError,  # the disk is full
    torch.linalg.LinAlgError,
)


def recorded(
    work: Callable[[dict[str, Any], Interruption], None], experiment: str, seed: int | None, folder: Path
) -> dict[str, Any]:
    """Do the work of a run and write metrics.json.

    Args:
        work: puts its results into the metrics that it is given.
        experiment: its name.
        seed: None of a run that draws nothing.
        folder: of the run.

    Returns:
        What metrics.json holds; `status` is "failed", with `error`, after one of FAILURES. Anything else that is raised
        is written there too, and raised on.
    """
    started = time.perf_counter()
    metrics = _failed(experiment)
    if seed is not None:
        metrics["seed"] = seed
    try:
        with Interruption() as interruption:
            work(metrics, interruption)
        metrics["status"] = "complete"
    except FAILURES as error:
        metrics["error"] = _sentence(error)
        log.error("failed: %s", error)
    except Interrupted as error:
        metrics["error"] = error.told(folder / "checkpoints" / "last.pt")
        log.error("%s", metrics["error"])
        raise
    except BaseException as error:
        metrics["error"] = _sentence(error)
        raise
    finally:
        metrics["wall_time_s"] = time.perf_counter() - started
        run_folder.close(folder, metrics)
    log.info("%s in %.1f s; everything lies in %s", metrics["status"], metrics["wall_time_s"], folder)
    return metrics


def write_refusal(
    folder: Path, experiment: str, overrides: list[str], config: Config | EstimateConfig | None, error: BaseException
) -> dict[str, Any]:
    """What a job of a multirun leaves in its existing folder if its configuration cannot run: the others go on.

    Where an earlier run has left results, nothing is written: what stands in the way now, such as a module that is
    not found, need not for ever.

    Returns:
        What metrics.json holds, with status failed; config.yaml stands beside it if there is a configuration.
    """
    metrics = _failed(experiment) | {"error": _sentence(error), "overrides": effective(overrides), "wall_time_s": 0.0}
    if config is not None:
        metrics |= {key: getattr(config, key) for key in ("seed", "data") if hasattr(config, key)}
        metrics["config_hash"] = run_folder.config_hash(config)
    if run_folder.has_results(folder):
        log.error("%s: keeps what an earlier run has left", folder)
        return metrics
    if config is not None:
        run_folder.write_config(folder, config)
    run_folder.write_metrics(folder, metrics)
    return metrics


def _failed(experiment: str) -> dict[str, Any]:
    return {
        "status": "failed",
        "error": None,
        "experiment": experiment,
        "config_hash": None,
        "uwirl_version": uwirl.__version__,
    }


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
