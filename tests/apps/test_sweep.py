"""Sweeps: launchers agree, one bad job stops no other, and a sweep that is started again does what is left to do."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from uwirl.apps.program import MOST_BYTES, folder_name

QUIET = ("logging.figures=false", "logging.tensorboard=false")
QUICK = ("planner=pd", "experiment=fig5_free", "scenario.duration_s=5", *QUIET)
ESTIMATORS = ("faulty", "least_squares", "maximum_likelihood", "oracle")
JOBLIB = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


def uwirl(cwd: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "uwirl.apps.run", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


def sweep(cwd: Path, name: str, *launcher: str) -> subprocess.CompletedProcess[str]:
    estimators = f"estimator={','.join(ESTIMATORS)}"
    place = f"hydra.sweep.dir={name}"
    return uwirl(cwd, "-m", "--config-dir", str(cwd / "mine"), *QUICK, estimators, place, *launcher)


def metrics(folder: Path) -> dict[str, dict]:
    """Of each estimator's job; times told apart from results."""
    found = {}
    for path in folder.rglob("metrics.json"):
        (name,) = (name for name in ESTIMATORS if f"estimator={name}," in path.parent.name)
        found[name] = json.loads(path.read_text())
    return found


def results(folder: Path) -> dict[str, dict]:
    return {name: {k: v for k, v in job.items() if k != "wall_time_s"} for name, job in metrics(folder).items()}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """One sweep by each launcher, of which the estimator `faulty` fails: it tells nothing of the paper's channel."""
    cwd = tmp_path_factory.mktemp("sweep")
    (cwd / "mine" / "estimator").mkdir(parents=True)
    choose(cwd, "disk")
    return cwd, sweep(cwd, "one"), sweep(cwd, "two", *JOBLIB)


def choose(cwd: Path, name: str) -> None:
    (cwd / "mine" / "estimator" / "faulty.yaml").write_text(f"name: {name}\n")


def test_one_failure_of_four_is_told(swept):
    cwd, *ran = swept
    for folder, process in zip(("one", "two"), ran, strict=True):
        assert process.returncode == 1, process.stderr
        assert "Traceback" not in process.stderr
        found = metrics(cwd / folder)
        assert {name: job["status"] for name, job in found.items()} == {
            "faulty": "failed",
            "least_squares": "complete",
            "maximum_likelihood": "complete",
            "oracle": "complete",
        }
        assert found["faulty"]["error"].startswith("NoTargetError: estimator: the estimated SNR does not fall")
        assert "estimator=faulty" in found["faulty"]["overrides"]


def test_launchers_agree_to_the_last_digit(swept):
    cwd = swept[0]
    assert len(results(cwd / "one")) == 4
    assert results(cwd / "one") == results(cwd / "two")


def test_started_again_only_what_is_left_runs(swept):
    cwd = swept[0]
    before = metrics(cwd / "one")
    choose(cwd, "oracle")
    again = sweep(cwd, "one")
    after = metrics(cwd / "one")
    assert again.returncode == 0
    assert again.stdout.count("skipped: complete") == 3
    assert after["faulty"]["status"] == "complete"
    assert {name: job for name, job in after.items() if name != "faulty"} == {
        name: job for name, job in before.items() if name != "faulty"
    }
    # Another worker was killed besides: its folder is there, its metrics are not. One was of another configuration.
    (killed,) = (cwd / "two").glob("estimator=least*/metrics.json")
    killed.unlink()
    (changed,) = (cwd / "two").glob("estimator=oracle*/metrics.json")
    changed.write_text(json.dumps(json.loads(changed.read_text()) | {"config_hash": "another"}))
    again = sweep(cwd, "two", *JOBLIB)
    assert again.returncode == 0
    assert again.stdout.count("skipped: complete") == 1
    assert results(cwd / "two") == results(cwd / "one")


def test_run_folder_of_another_run_is_left_as_it_is(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "config.yaml").write_text("seed: 3\n")
    (folder / "metrics.json").write_text('{"status": "complete"}')
    result = uwirl(tmp_path, *QUICK, "hydra.run.dir=run")
    assert result.returncode == 2
    assert result.stderr == f"uwirl: hydra.run.dir: {folder} holds another run, and is left as it is\n"
    assert (folder / "config.yaml").read_text() == "seed: 3\n"
    assert (folder / "metrics.json").read_text() == '{"status": "complete"}'


def test_folder_is_named_by_its_overrides():
    assert folder_name("planner=pd,seed=0") == "planner=pd,seed=0"
    assert folder_name("") == "defaults"


@pytest.mark.parametrize("overrides", ["x=a/b", "x=a\\b", "x=../../etc", "x=" + "1" * 300, "x=" + "ä" * 150])
def test_names_no_file_system_takes_are_shortened(overrides: str):
    name = folder_name(overrides)
    assert len(name.encode()) <= MOST_BYTES
    assert Path(name).name == name


def test_names_never_collide():
    long = "scenario.start=[[" + "1," * 200
    given = ["x=a/b", "x=a\\b", "x=a_b", long + "1]]", long + "2]]", "", "x=1", "x=1,y=2"]
    assert len({folder_name(overrides) for overrides in given}) == len(given)
