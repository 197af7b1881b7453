"""The floors of the house: imports only go down, Hydra stays above, and the true channel is behind one door.

The contracts stand in pyproject.toml; each is broken here once in a copy, to see that it would be noticed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LINT = "from importlinter.cli import lint_imports_command; lint_imports_command()"
# What is under the floors of a copy is the contracts and the package, without its data.
PACKAGE = "uwirl"


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """In a folder that holds pyproject.toml and the package."""
    command = [sys.executable, "-c", LINT, "--no-cache", "--no-logo"]
    # On one line each, however long their names.
    wide = os.environ | {"COLUMNS": "200"}
    return subprocess.run(command, cwd=folder, env=wide, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package, to be spoilt."""
    folder = tmp_path_factory.mktemp("house")
    shutil.copy(ROOT / "pyproject.toml", folder)
    shutil.copytree(ROOT / PACKAGE, folder / PACKAGE, ignore=shutil.ignore_patterns("__pycache__", "conf"))
    return folder


def test_contracts_are_kept():
    result = lint(ROOT)
    assert result.returncode == 0, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("module", "line", "broken"),
    [
        ("world/geometry.py", "import uwirl.irl.rls as r", "Imports only go down"),
        ("irl/rls.py", "from ..world import geometry", "Imports only go down"),
        ("world/obstacles.py", "from uwirl import build", "Imports only go down"),
        ("snr/model.py", "def f():\n    from uwirl.study.checkpoint import save", "Imports only go down"),
        ("motion/cost.py", "from uwirl.baselines import pd", "Imports only go down"),
        ("study/campaign.py", "from uwirl.algorithm import algorithm_1", "Imports only go down"),
        ("algorithm.py", "from uwirl.runs import run", "Imports only go down"),
        ("attic.py", "", "Imports only go down"),
        ("motion/cost.py", "from uwirl.config.schema import CostConfig", "without settings"),
        ("study/checkpoint.py", "from hydra.utils import instantiate", "know Hydra"),
        ("runs/run.py", "import hydra", "know Hydra"),
        ("motion/targets.py", "from uwirl.world.truth import truth_of", "The true channel"),
        ("snr/estimators.py", "def f():\n    from ..world import truth", "The true channel"),
        ("algorithm.py", "import uwirl.world.truth", "The true channel"),
        ("world/agent.py", "from uwirl.world.truth import Truth", "The true channel"),
        ("irl/rls.py", "from uwirl import Relay", "The package's face"),
        ("world/agent.py", "import uwirl", "The package's face"),
    ],
)
def test_what_breaks_them_is_noticed(house: Path, module: str, line: str, broken: str):
    place = house / PACKAGE / module
    before = place.read_text(encoding="utf-8") if place.exists() else None
    place.write_text(f"{before or ''}\n{line}\n", encoding="utf-8")
    try:
        result = lint(house)
    finally:
        if before is None:
            place.unlink()
        else:
            place.write_text(before, encoding="utf-8")
    assert result.returncode == 1, result.stdout + result.stderr
    assert re.search(rf"{broken}.* BROKEN\b", result.stdout), result.stdout


def test_nobody_takes_the_truth_by_another_door():
    """From somebody who may import it, or from where the environment keeps it."""
    names = re.compile(r"\btruth_of\b|\._truth\b")
    sources = {path: path.read_text(encoding="utf-8") for path in (ROOT / PACKAGE).rglob("*.py")}
    told = {str(path.relative_to(ROOT / PACKAGE)) for path, source in sources.items() if names.search(source)}
    may = {"world/truth.py", "world/relay.py", "world/readings.py", "build.py"}
    assert {name for name in told - may if not name.startswith("study/")} == set()
