"""A search: the mean over seeds is made small, what failed stops nothing, and the same command again continues."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf

from hydra_plugins.uwirl_search import Trials
from uwirl.apps import run

QUICK = ("planner=pd", "experiment=fig5_free", "logging.figures=false", "logging.tensorboard=false")
MINE = ("-m", "--config-dir", "mine", "hydra/sweeper=mine", *QUICK)


class Launcher:
    """Returns what a function makes of the overrides; an exception stands for a job that raised it."""

    def __init__(self, flown: Callable[[Sequence[str]], Any]):
        self.flown = flown
        self.launched: list[tuple[int, list[str]]] = []

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> list[JobReturn]:
        self.launched += [(initial_job_idx + i, list(words)) for i, words in enumerate(job_overrides)]
        returns = []
        for words in job_overrides:
            value = self.flown(words)
            status = JobStatus.FAILED if isinstance(value, Exception) else JobStatus.COMPLETED
            returns.append(JobReturn(overrides=list(words), status=status, _return_value=value))
        return returns


def test_a_trial_is_a_job_for_each_seed():
    launcher = Launcher(lambda job: {"x=1": 10.0, "x=2": 20.0}[job[0]] + float(job[1].removeprefix("seed=")))
    returns = Trials(launcher, [0, 4]).launch([["x=1"], ["x=2"]], initial_job_idx=3)
    assert [trial.return_value for trial in returns] == [12.0, 22.0]
    assert launcher.launched == [
        (6, ["x=1", "seed=0"]),
        (7, ["x=1", "seed=4"]),
        (8, ["x=2", "seed=0"]),
        (9, ["x=2", "seed=4"]),
    ]


@pytest.mark.parametrize("failed", [None, RuntimeError("a bug")])
def test_one_failed_seed_fails_its_trial_alone(failed: Any):
    trials = Trials(Launcher(lambda job: failed if job == ["x=1", "seed=1"] else 3.0), [0, 1])
    assert [trial.return_value for trial in trials.launch([["x=1"], ["x=2"]], 0)] == [None, 3.0]
    assert trials.succeeded == 1


def space(cwd: Path, *params: str, trials: int) -> None:
    file = cwd / "mine" / "hydra" / "sweeper" / "mine.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"defaults: [search]\nseeds: [0, 1]\nn_trials: {trials}\nparams:\n  " + "\n  ".join(params) + "\n")


def uwirl(cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uwirl.apps.run", *MINE, "hydra.sweep.dir=search", *words]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def flown(cwd: Path) -> dict[str, list[dict[str, Any]]]:
    """Metrics of a search's jobs, by what was searched."""
    found: dict[str, list[dict[str, Any]]] = {}
    for path in sorted((cwd / "search").glob("*/metrics.json")):
        job = json.loads(path.read_text())
        found.setdefault(next(o for o in job["overrides"] if "gain" in o or "duration" in o), []).append(job)
    return found


def test_search_and_continue(tmp_path: Path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    space(tmp_path, "planner.position_gain.0: interval(5, 20)", "scenario.duration_s: 5.0", trials=2)
    first = uwirl(tmp_path)
    assert first.returncode == 0, first.stderr
    before = flown(tmp_path)
    assert [len(jobs) for jobs in before.values()] == [2, 2]
    means = {key: sum(job["cost_total"] for job in jobs) / 2 for key, jobs in before.items()}
    best: Any = OmegaConf.load(tmp_path / "search" / "optimization_results.yaml")
    assert best.best_value == pytest.approx(min(means.values()), rel=1e-12)
    assert f"planner.position_gain.0={best.best_params['planner.position_gain.0']}" == min(means, key=means.get)

    again = uwirl(tmp_path, "hydra.sweeper.n_trials=3")
    assert again.returncode == 0, again.stderr
    after = flown(tmp_path)
    assert again.stdout.count("skipped: complete") == 4
    assert len(after) == 3
    assert {key: after[key] for key in before} == before


def test_a_search_goes_on_after_what_failed(tmp_path: Path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    # Not a whole number of steps.
    space(tmp_path, "scenario.duration_s: choice(5.0, 5.01)", trials=4)
    result = uwirl(tmp_path)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    jobs = flown(tmp_path)
    assert [job["status"] for job in jobs["scenario.duration_s=5.01"]] == ["failed", "failed"]
    assert [job["status"] for job in jobs["scenario.duration_s=5.0"]] == ["complete", "complete"]
    best: Any = OmegaConf.load(tmp_path / "search" / "optimization_results.yaml")
    assert best.best_params == {"scenario.duration_s": 5.0}


def test_a_search_without_a_best_says_so(tmp_path: Path):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    space(tmp_path, "scenario.duration_s: choice(5.01, 5.02)", trials=2)
    result = uwirl(tmp_path)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert result.stderr.splitlines()[-1].startswith("uwirl: hydra/sweeper: no trial has a J (cost_total)")


def test_a_job_that_raises_is_told(tmp_path: Path, call: Callable[..., None], monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("hydra_plugins.hydra_optuna_sweeper")
    space(tmp_path, "planner.position_gain.0: choice(5.0, 6.0)", trials=3)
    monkeypatch.chdir(tmp_path)

    def fly(program: run.Run, config: Any) -> dict[str, Any]:
        if config.planner.position_gain[0] == 6.0:
            raise RuntimeError("a bug")
        return {"status": "complete", "cost_total": 1.0}

    monkeypatch.setattr(run.Run, "job", fly)
    with pytest.raises(SystemExit) as caught:
        call(run.main, *MINE, "hydra.sweep.dir=search")
    assert caught.value.code == 1
    best: Any = OmegaConf.load(tmp_path / "search" / "optimization_results.yaml")
    assert best.best_value == 1.0
