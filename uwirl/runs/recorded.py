"""The entries of metrics.json that every run has, however it ends: its duration and its outcome."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from uwirl.world.agent import InterfaceError
from uwirl.world.trajectory import DivergedError

log = logging.getLogger("uwirl")

# Begins the line of a warning on the terminal.
WARNING = "warning: "
# Errors that may end a run without being a bug; their message goes into metrics.json.
FAILURES = (
    CheckpointError,
    ConfigError,  # an object of a custom class lacks something
    DivergedError,
    InterfaceError,
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
        work: does the work; adds results to the given metrics. Warnings that are logged meanwhile go into `warnings`.
        experiment: name of the experiment.
        seed: None for a run without random numbers.
        folder: folder of the run.

    Returns:
        Content of metrics.json; `status` is "failed", with `error`, after one of FAILURES. Any other exception is
        written there, too, and raised again; after a signal, `status` is "interrupted".
    """
    started = time.perf_counter()
    metrics = _failed(experiment)
    if seed is not None:
        metrics["seed"] = seed
    try:
        with Interruption() as interruption, _noted(metrics["warnings"]):
            work(metrics, interruption)
        metrics["status"] = "complete"
    except FAILURES as error:
        metrics["error"] = _sentence(error)
        log.error("failed: %s", error)
    except Interrupted as error:
        metrics |= {"status": "interrupted", "error": error.told(folder / "checkpoints" / "last.pt")}
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
    """Write the folder of a job of a multirun whose configuration cannot run, so that the others continue.

    A folder with results of an earlier run is left as it is: the obstacle, such as a missing module, may be temporary.

    Returns:
        Content of metrics.json, with status failed; config.yaml is written too if there is a configuration.
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


def warn(sentence: str) -> None:
    """Log a warning; `recorded` writes it to metrics.json too."""
    log.warning("%s%s", WARNING, sentence)


@contextmanager
def _noted(sentences: list[str]) -> Iterator[None]:
    """Context in which warnings are appended to a list when they are logged."""

    class Notes(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.levelno == logging.WARNING:
                sentences.append(record.getMessage().removeprefix(WARNING))

    notes = Notes()
    log.addHandler(notes)
    try:
        yield
    finally:
        log.removeHandler(notes)


def _failed(experiment: str) -> dict[str, Any]:
    return {
        "status": "failed",
        "error": None,
        "experiment": experiment,
        "config_hash": None,
        "uwirl_version": uwirl.__version__,
        "warnings": [],
    }


def _sentence(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"
