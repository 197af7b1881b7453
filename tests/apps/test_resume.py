"""Runs that were killed, and what follows: resumed, refused, started from."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from uwirl.apps import continuation, evaluate
from uwirl.apps.continuation import continued
from uwirl.apps.run import main
from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose
from uwirl.config.compose import folder as conf
from uwirl.config.validate import validate
from uwirl.runs import algorithm, saving
from uwirl.runs.interruption import Interrupted
from uwirl.runs.refusal import write_refusal
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError

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
    return algorithm.run(config, "fig5_free", folder, overrides)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run that was never interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    go(folder, *SHORT)
    return folder


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
    for name in ("last.pt", "best.pt"):
        a, b = (checkpoint.load(path / "checkpoints" / name) for path in (folder, whole))
        assert all(torch.equal(a[key], b[key]) for key in ("actor", "critic", "trim"))
    texts = [(path / "config.yaml").read_text() for path in (folder, whole)]
    assert texts[0].replace("every: 1\n", "every: 10\n") == texts[1]
    assert not list(folder.rglob("*.tmp"))


def start_and_kill(folder: Path, moment_s: float) -> None:
    """SIGKILL after some time, unless the run is over by then."""
    process = subprocess.Popen(
        command(*SHORT, "checkpoint.every=1", f"hydra.run.dir={folder}"),
        cwd=folder.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        process.wait(moment_s)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
        process.wait()


def finish(folder: Path, call: Callable[..., None]) -> None:
    """`uwirl resume=...`, or what started the run where the answer is that there is no checkpoint."""
    if (folder / "checkpoints" / "last.pt").exists():
        call(main, f"resume={folder}")
        # Its log goes on in the same file.
        assert "continues after iteration" in (folder / "run.log").read_text()
        return
    if folder.exists():
        with pytest.raises(CheckpointError, match="start it again with the command that started it"):
            checkpoint.locate(folder)
    go(folder, *SHORT)


# SIGKILL where the digest is new and the checkpoint, after 16 iterations, old.
KILLED = """
import os, signal
from uwirl.apps.run import main
put, count = os.replace, iter(range(10**6))
def replace(a, b):
    put(a, b)
    if str(b).endswith("sha256") and next(count) == 8:
        os.kill(os.getpid(), signal.SIGKILL)
os.replace = replace
main()
"""


def test_killed_while_it_saves(tmp_path, whole):
    folder = tmp_path / "run"
    killed = [sys.executable, "-c", KILLED, *SHORT, "checkpoint.every=1", f"hydra.run.dir={folder}"]
    assert subprocess.run(killed, cwd=tmp_path, capture_output=True, check=False).returncode == -signal.SIGKILL
    assert not (folder / "metrics.json").exists()
    assert len((folder / "checkpoints" / "last.pt.sha256").read_text().splitlines()) == 2
    assert checkpoint.load(folder / "checkpoints" / "last.pt")["iteration"] == 16
    go(folder, *SHORT, "checkpoint.every=1", f"resume={folder}")
    assert_same(folder, whole)


def test_a_sweep_goes_on_where_a_job_was_killed(tmp_path, whole, call):
    words = ["-m", *SHORT, "checkpoint.every=1", f"hydra.sweep.dir={tmp_path}"]
    subprocess.run([sys.executable, "-c", KILLED, *words], cwd=tmp_path, capture_output=True, check=False)
    call(main, *words)
    (log,) = tmp_path.glob("*/run.log")
    assert "continues after iteration 16" in log.read_text()
    assert_same(log.parent, whole)


@pytest.mark.parametrize(
    ("metrics", "goes_on"),
    [
        (None, True),
        ({"status": "failed", "error": "interrupted by SIGTERM; resume=last.pt continues"}, True),
        ({"status": "failed", "error": "DivergedError: nu is not finite"}, False),
        ({"status": "complete", "error": None}, False),
    ],
)
def test_what_counts_as_unfinished(whole, tmp_path, metrics, goes_on):
    shutil.copytree(whole / "checkpoints", tmp_path / "checkpoints")
    if metrics is not None:
        (tmp_path / "metrics.json").write_text(json.dumps(metrics))
    path = tmp_path / "checkpoints" / "last.pt"
    config_hash = checkpoint.load(path)["config_hash"]
    assert saving.unfinished(tmp_path, config_hash) == (path if goes_on else None)
    assert saving.unfinished(tmp_path, "another") is None
    path.write_bytes(path.read_bytes()[:-1])
    assert saving.unfinished(tmp_path, config_hash) is None


def test_killed_at_a_random_moment(tmp_path, whole, call):
    folder = tmp_path / "run"
    start_and_kill(folder, random.uniform(1.0, 5.0))
    finish(folder, call)
    assert_same(folder, whole)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_killed_at_any_of_many_random_moments(tmp_path, whole, call, number):
    """Two times each, the second while it resumes."""
    started = time.perf_counter()
    uwirl(tmp_path, "--version")
    idle = time.perf_counter() - started
    folder = tmp_path / "run"
    start_and_kill(folder, random.uniform(0.5 * idle, idle + 3.0))
    if (folder / "checkpoints" / "last.pt").exists():
        process = subprocess.Popen(command(f"resume={folder}"), cwd=tmp_path, stdout=subprocess.DEVNULL)
        time.sleep(random.uniform(0.5 * idle, idle + 2.0))
        process.send_signal(signal.SIGKILL)
        process.wait()
    finish(folder, call)
    assert_same(folder, whole)


def test_sigterm_finishes_the_leg_and_says_how_to_go_on(tmp_path, whole):
    """Sent by the run to itself while it flies its fifth leg, so that the moment is always the same."""
    program = (
        "import os, signal; from uwirl.apps.run import main; from uwirl.motion import experience\n"
        "fly = experience._fly_leg\n"
        "def leg(env, flight, *rest):\n"
        "    if flight.leg == 4: os.kill(os.getpid(), signal.SIGTERM)\n"
        "    return fly(env, flight, *rest)\n"
        "experience._fly_leg = leg; main()"
    )
    folder = tmp_path / "run"
    command = [sys.executable, "-c", program, *SHORT, f"hydra.run.dir={folder}"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 143
    last = folder / "checkpoints" / "last.pt"
    written = json.loads((folder / "metrics.json").read_text())
    assert (written["status"], written["error"]) == ("failed", f"interrupted by SIGTERM; resume={last} continues")
    content = checkpoint.load(last)
    assert (content["iteration"], content["learner"]["flight"]["leg"]) == (20, 5)
    go(folder, *SHORT, f"resume={last}")
    assert_same(folder, whole)


def test_sigint_before_the_first_checkpoint_says_so(tmp_path, monkeypatch):
    def interrupted(*_):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(algorithm, "estimate_each_vehicle", interrupted)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(Interrupted) as caught:
        go(tmp_path, *SHORT)
    assert caught.value.exit_code == 130
    error = json.loads((tmp_path / "metrics.json").read_text())["error"]
    assert error == (
        "interrupted by SIGINT with nothing saved to continue from; start it again with the command that started it"
    )
    assert signal.getsignal(signal.SIGINT) is before


def test_second_signal_kills_at_once(tmp_path):
    program = (
        "import os, signal; from uwirl.apps.run import main; from uwirl.motion import experience\n"
        "def leg(*_):\n"
        "    for _ in range(2): os.kill(os.getpid(), signal.SIGTERM)\n"
        "experience._fly_leg = leg; main()"
    )
    command = [sys.executable, "-c", program, *SHORT, "hydra.run.dir=run"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert result.returncode == -signal.SIGTERM
    assert not (tmp_path / "run" / "metrics.json").exists()


def test_every_tells_how_often_it_is_saved(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(saving.Checkpoints, "last", lambda self, planner, *_: saved.append(planner.state.flight.leg))
    go(tmp_path, *SHORT, "checkpoint.every=4")
    # In flight, at the end of learning, and with the metrics.
    assert saved == [4, 6, 6]


def test_a_complete_run_resumed_elsewhere_is_the_same(tmp_path, whole):
    go(tmp_path, *SHORT, f"resume={whole}")
    assert_same(tmp_path, whole)


def test_resume_alone_takes_the_settings_of_the_run(whole):
    arguments = [f"resume={whole}", "logging.progress=true", "checkpoint.every=3"]
    line = continued(arguments, compose(arguments))
    assert f"hydra.run.dir='{whole}'" in line
    config = compose([text for text in line if not text.startswith("hydra.")])
    assert config.resume == str(whole / "checkpoints" / "last.pt")
    assert (config.logging.progress, config.checkpoint.every) == (True, 3)
    given = compose(SHORT)
    assert replace(config, resume=None, logging=given.logging, checkpoint=given.checkpoint) == given
    # The same said again is no difference, and the folder is the user's to choose.
    elsewhere = continued([*SHORT, *arguments, "hydra.run.dir=x"], compose([*SHORT, *arguments]))
    assert [text for text in elsewhere if text.startswith("hydra.run.dir=")] == ["hydra.run.dir=x"]


def test_other_settings_are_refused_and_listed(whole, tmp_path):
    overrides = [*SHORT, "seed=3", "cost.beta_2=7", "basis=error_velocity"]
    result = uwirl(tmp_path, *overrides, f"resume={whole}")
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    for text in (
        "leave them out to continue it",
        "seed = 0 there, 3 here",
        "basis.name = link_frame there, error_velocity here",
        "cost.beta_2 = ",
    ):
        assert text in result.stderr
    assert result.stderr.count(" there, ") == 4
    assert list(tmp_path.iterdir()) == []


def test_defaults_that_changed_since_are_refused(whole, tmp_path):
    content = checkpoint.load(whole / "checkpoints" / "last.pt")
    content["config"]["planner"]["updates"] = 5
    path = tmp_path / "checkpoints" / "last.pt"
    checkpoint.save(path, content)
    with pytest.raises(CheckpointError, match=r"defaults have changed since\): planner.updates = 5 there, 4 here$"):
        continued([f"resume={path}"], compose([f"resume={path}"]))


def test_settings_that_are_no_longer_possible_leave_the_run_as_it_is(whole, tmp_path, call, monkeypatch, capsys):
    def refuse(config):
        raise ConfigError("planner.target", "no module 'mine'")

    shutil.copytree(whole, tmp_path / "run")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.setattr(continuation, "validate", refuse)
    with pytest.raises(SystemExit) as ended:
        call(main, f"resume={tmp_path}/run")
    assert ended.value.code == 2
    assert capsys.readouterr().err == "uwirl: planner.target: no module 'mine'\n"
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_resumed_run_leaves_another_ones_folder(whole, tmp_path, call, capsys):
    shutil.copytree(whole, tmp_path / "run")
    call(main, "planner=pd", SHORT[0], *SHORT[2:], f"hydra.run.dir={tmp_path}/other")
    before = (tmp_path / "other" / "metrics.json").read_bytes()
    with pytest.raises(SystemExit) as ended:
        call(main, f"resume={tmp_path}/run", f"hydra.run.dir={tmp_path}/other")
    assert ended.value.code == 2
    assert "holds another run, and is left as it is" in capsys.readouterr().err
    assert (tmp_path / "other" / "metrics.json").read_bytes() == before


def test_hydras_own_groups_are_no_settings_of_the_run(whole):
    arguments = [f"resume={whole}", "hydra/job_logging=default"]
    assert "hydra/job_logging=default" in continued(arguments, compose(arguments))


def test_files_of_ones_own_are_found_again(tmp_path, call, whole):
    (tmp_path / "mine" / "channel").mkdir(parents=True)
    paper = (conf() / "channel" / "paper.yaml").read_text()
    (tmp_path / "mine" / "channel" / "lake.yaml").write_text(paper.replace("zeta_dB: 0.07", "zeta_dB: 0.0"))
    mine = ("--config-dir", str(tmp_path / "mine"))
    call(main, *mine, *SHORT, "channel=lake", f"hydra.run.dir={tmp_path}/run")
    shutil.copytree(tmp_path / "run", tmp_path / "whole")
    call(main, *mine, f"resume={tmp_path}/run")
    assert_same(tmp_path / "run", tmp_path / "whole")
    call(evaluate.main, *mine, f"checkpoint={tmp_path}/run", f"hydra.run.dir={tmp_path}/again")
    cost, again = (
        json.loads((tmp_path / name / "metrics.json").read_text())["cost_total"] for name in ("run", "again")
    )
    assert cost == again


def test_a_refused_job_keeps_what_was_found_before(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "job")
    before = (whole / "metrics.json").read_bytes()
    refused = write_refusal(tmp_path / "job", "fig5_free", [], None, ConfigError("seed", "no"))
    assert refused["status"] == "failed"
    assert (tmp_path / "job" / "metrics.json").read_bytes() == before
    assert (tmp_path / "job" / "checkpoints" / "last.pt").exists()


def test_a_checkpoint_without_a_run_folder_needs_one(whole, tmp_path):
    for name in ("last.pt", "last.pt.sha256"):
        (tmp_path / name).write_bytes((whole / "checkpoints" / name).read_bytes())
    arguments = [f"resume={tmp_path / 'last.pt'}"]
    with pytest.raises(CheckpointError, match=r"lies in no run folder; say where to continue with hydra\.run\.dir"):
        continued(arguments, compose(arguments))


def test_a_sweeps_folder_needs_no_thought(whole, tmp_path):
    """Its = and , are quoted for Hydra."""
    folder = tmp_path / "seed=3,planner.updates=2" / "checkpoints"
    folder.mkdir(parents=True)
    for name in ("last.pt", "last.pt.sha256"):
        (folder / name).write_bytes((whole / "checkpoints" / name).read_bytes())
    arguments = [f"resume='{folder.parent}'"]
    line = continued(arguments, compose(arguments))
    assert compose([line[-2]]).resume == str(folder / "last.pt")


def test_best_holds_the_cheapest_policy_and_no_learner(whole, tmp_path):
    best = checkpoint.load(whole / "checkpoints" / "best.pt")
    costs = json.loads((whole / "metrics.json").read_text())["cost_per_iteration"]
    assert best["cost_total"] == min(costs)
    assert costs[best["iteration"] - 1] == min(costs)
    metrics = go(tmp_path, *SHORT, f"resume={whole / 'checkpoints' / 'best.pt'}")
    assert metrics["error"].endswith("best.pt: holds a policy but no learner to continue; resume from last.pt")


def test_tensorboard_tells_every_iteration_once(whole, tmp_path):
    """Resumed in the folder of its events after one more iteration than was saved, and in another folder."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    on = (*SHORT, "logging.tensorboard=true", "checkpoint.every=1")
    saved = []

    def stop(self, planner, *rest):
        last(self, planner, *rest)
        saved.append(planner.state.flight.leg)
        if len(saved) == 3:
            raise KeyboardInterrupt

    last = saving.Checkpoints.last
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(saving.Checkpoints, "last", stop)
        with pytest.raises(KeyboardInterrupt):
            go(tmp_path / "a", *on)
    for folder in ("b", "a"):
        go(tmp_path / folder, *on, f"resume={tmp_path / 'a'}")
        events = EventAccumulator(str(tmp_path / folder / "tb")).Reload().Scalars("learning/weight_change")
        assert [event.step for event in events] == list(range(1, 25))
