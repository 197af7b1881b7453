"""Short learning runs, and whether two left the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch

from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.runs.run import run
from uwirl.study import checkpoint

QUIET = ("logging.figures=false", "logging.tensorboard=false", "logging.animation=false", "logging.progress=false")
SHORT = ("experiment=fig5_free", "planner.max_time_s=44", "scenario.duration_s=2", *QUIET)


def command(*overrides: str, program: str = "-m uwirl.apps.run") -> list[str]:
    return [sys.executable, *program.split(" ", 1), *overrides]


def uwirl(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*overrides), cwd=folder, capture_output=True, text=True, check=False)


def go(folder: Path, *overrides: str) -> dict:
    """The same in this process."""
    folder.mkdir(parents=True, exist_ok=True)
    config = compose(overrides)
    validate(config)
    return run(config, "fig5_free", folder, overrides)


def assert_same(folder: Path, whole: Path) -> None:
    """Bitwise, but for the time that it took."""
    found, expected = (json.loads((path / "metrics.json").read_text()) for path in (folder, whole))
    assert found.pop("wall_time_s") > 0.0
    expected.pop("wall_time_s")
    assert found == expected
    assert found["status"] == "complete"
    ours, theirs = (np.load(path / "trajectory.npz") for path in (folder, whole))
    assert ours.files == theirs.files
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours.files)
    assert (folder / "iterations.csv").read_text() == (whole / "iterations.csv").read_text()
    for name in ("last.pt", "best.pt"):
        a, b = (checkpoint.load(path / "checkpoints" / name) for path in (folder, whole))
        assert all(torch.equal(a[key], b[key]) for key in ("actor", "critic", "trim"))
    texts = [(path / "config.yaml").read_text() for path in (folder, whole)]
    assert texts[0].replace("every: 1\n", "every: 10\n") == texts[1]
    assert not list(folder.rglob("*.tmp"))
