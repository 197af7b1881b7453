"""Runs that were killed or interrupted, and how they go on."""

from __future__ import annotations

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from flights import SHORT, assert_same, command, go, uwirl

from uwirl import algorithm
from uwirl.apps.run import main
from uwirl.runs import saving
from uwirl.runs.interruption import Interrupted
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError


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
        ({"status": "interrupted", "error": "interrupted by SIGTERM; resume=last.pt continues"}, True),
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
        "fly = experience.Exploration.flown\n"
        "def leg(self, env, flight, *rest):\n"
        "    if flight.leg == 4: os.kill(os.getpid(), signal.SIGTERM)\n"
        "    return fly(self, env, flight, *rest)\n"
        "experience.Exploration.flown = leg; main()"
    )
    folder = tmp_path / "run"
    command = [sys.executable, "-c", program, *SHORT, f"hydra.run.dir={folder}"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 143
    last = folder / "checkpoints" / "last.pt"
    written = json.loads((folder / "metrics.json").read_text())
    assert (written["status"], written["error"]) == ("interrupted", f"interrupted by SIGTERM; resume={last} continues")
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
        "experience.Exploration.flown = leg; main()"
    )
    command = [sys.executable, "-c", program, *SHORT, "hydra.run.dir=run"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert result.returncode == -signal.SIGTERM
    assert not (tmp_path / "run" / "metrics.json").exists()
