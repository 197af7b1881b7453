"""The console entry on a bad configuration: exit code 2, one message with the key, nothing left behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


def uwirl(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uwirl.apps.run", *overrides]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("override", "key"),
    [
        ("cost.R=[0.1,0.1,-1,0.1]", "cost.R"),  # breaks a rule
        ("solver.name=z_rsl", "solver.name"),  # one letter from a name
        ("scenario.dt_s=soon", "scenario.dt_s"),  # the wrong type
    ],
)
def test_bad_value_is_one_line(tmp_path: Path, override: str, key: str):
    result = uwirl(tmp_path, override)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("uwirl: ")
    assert key in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_unknown_key_leaves_nothing(tmp_path: Path):
    result = uwirl(tmp_path, "scenario.duration=80")
    assert result.returncode == 2
    assert result.stderr.startswith("uwirl: ")
    assert "scenario.duration" in result.stderr
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []
