"""Places that cannot be written, are full or in use, and processes that are killed: one line, nothing saved is lost."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from uwirl.apps import evaluate, run
from uwirl.study import checkpoint
from uwirl.study.run_folder import held

QUIET = ("logging.figures=false", "logging.tensorboard=false")
QUICK = ("planner=pd", "experiment=fig5_free", "scenario.duration_s=5", *QUIET)
LEARNS = (
    "experiment=fig5_free",
    "planner.max_time_s=60",
    "planner.model_time_s=1",
    "scenario.duration_s=2",
    "checkpoint.every=1",
    *QUIET,
)
JOBLIB = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
# The first saves of LEARNS are smaller, its last is larger.
MOST_BYTES = 135_000


def command(*overrides: str) -> list[str]:
    return [sys.executable, "-m", "uwirl.apps.run", *overrides]


def uwirl(cwd: Path, *overrides: str, **options) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*overrides), cwd=cwd, text=True, check=False, stderr=subprocess.PIPE, **options)


def status(folder: Path) -> str:
    return json.loads((folder / "metrics.json").read_text())["status"]


@pytest.fixture
def in_tmp(tmp_path, monkeypatch) -> Iterator[Path]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    (tmp_path / "file").touch()
    return tmp_path


@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("file", "File exists"),
        ("file/x", "Not a directory"),
        ("/proc/x", "No such file or directory"),
        ("x" * 300, "File name too long"),
    ],
)
@pytest.mark.parametrize("key", ["hydra.run.dir", "hydra.sweep.dir"])
def test_a_place_that_cannot_be_is_one_line_with_what_to_do(in_tmp, call, capsys, key, place, why):
    with pytest.raises(SystemExit) as ended:
        call(run.main, *QUICK, f"{key}={place}", *(["seed=0,1", "-m"] if "sweep" in key else []))
    assert ended.value.code == 2
    advice = "choose another place: hydra.run.dir=PATH, of a sweep hydra.sweep.dir=PATH"
    assert capsys.readouterr().err == f"uwirl: {place}: cannot be written ({why}); {advice}\n"
    assert sorted(path.name for path in in_tmp.iterdir()) == ["file"]


def test_a_log_that_cannot_be_opened_is_one_line(in_tmp, call, capsys):
    (in_tmp / "run" / "run.log").mkdir(parents=True)
    with pytest.raises(SystemExit) as ended:
        call(run.main, *QUICK, "hydra.run.dir=run")
    assert ended.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith(f"uwirl: {in_tmp / 'run' / 'run.log'}: cannot be written (Is a directory); choose")
    assert err.count("\n") == 1


def test_a_folder_in_use_is_refused(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    sweep = ("seed=0", "hydra.sweep.dir=.", "hydra.sweep.subdir=run", "-m")
    with held(folder):
        for words, code in (((), 2), (sweep, 1)):
            ended = uwirl(tmp_path, *QUICK, "hydra.run.dir=run", *words)
            assert ended.returncode == code
            assert (
                ended.stderr == f"uwirl: {folder}: another process is running in it; wait for it, or choose another\n"
            )
            assert [path.name for path in folder.iterdir()] == ["run.log"]
    assert uwirl(tmp_path, *QUICK, *sweep).returncode == 0


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """A run that could not save all that it learned."""
    cwd = tmp_path_factory.mktemp("full")

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))

    return cwd / "run", uwirl(cwd, *LEARNS, "hydra.run.dir=run", stdout=subprocess.PIPE, preexec_fn=limit)


def test_on_a_full_disk_what_was_saved_stays(full, tmp_path):
    folder, ended = full
    path = folder / "checkpoints" / "last.pt"
    assert (ended.returncode, ended.stderr) == (1, "")
    assert f"failed: [Errno 27] File too large: '{path}'\n" in ended.stdout
    assert status(folder) == "failed"
    assert not list(folder.rglob("*.tmp"))
    assert 1 < checkpoint.load(path)["iteration"] < 40
    assert uwirl(tmp_path, f"resume={folder}", "hydra.run.dir=on").returncode == 0
    assert status(tmp_path / "on") == "complete"


def test_evaluations_and_runs_leave_each_others_folders(full, in_tmp, call, capsys):
    folder, _ = full
    before = (folder / "metrics.json").read_bytes()
    with pytest.raises(SystemExit) as ended:
        call(evaluate.main, f"checkpoint={folder}", f"hydra.run.dir={folder}")
    assert ended.value.code == 2
    told = f"uwirl-evaluate: hydra.run.dir: {folder} holds another run, and is left as it is\n"
    assert capsys.readouterr().err == told
    assert (folder / "metrics.json").read_bytes() == before


def test_events_on_a_full_disk_are_one_line(tmp_path):
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    words = (*QUICK[:3], "logging.figures=false", "hydra.run.dir=run")
    ended = uwirl(tmp_path, *words, stdout=subprocess.PIPE, preexec_fn=limit)
    assert (ended.returncode, ended.stderr) == (1, "")
    assert ended.stdout.count("File too large") == 1


def test_nobody_has_to_read_what_is_printed(tmp_path):
    for place in ("/dev/full", os.devnull):
        with Path(place).open("w") as nowhere:
            ended = uwirl(tmp_path, *QUICK, f"hydra.run.dir=run{place}", stdout=nowhere)
        assert (ended.returncode, ended.stderr) == (0, "")
    read, write = os.pipe()
    os.close(read)
    ended = uwirl(tmp_path, *QUICK, "hydra.run.dir=unread", stdout=write)
    os.close(write)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert status(tmp_path / "unread") == "complete"


def workers(parent: int) -> list[int]:
    """joblib's, but for its own watchman."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(pid) for pid in children if b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def sweep_until_it_flies(cwd: Path) -> subprocess.Popen[str]:
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher")
    long = ("planner.max_time_s=6000", "seed=0,1,2", "hydra.sweep.dir=sweep")
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command("-m", *LEARNS, *long, *JOBLIB), cwd=cwd, text=True, **pipes)
    deadline = time.monotonic() + 120.0
    while len(list((cwd / "sweep").rglob("last.pt"))) < 2:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return process


def test_a_killed_worker_is_one_line(tmp_path):
    process = sweep_until_it_flies(tmp_path)
    os.kill(workers(process.pid)[0], signal.SIGKILL)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert err == "uwirl: a worker process was killed, perhaps for want of memory; the same command does what is left\n"
    for path in (tmp_path / "sweep").rglob("last.pt"):
        checkpoint.load(path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_who_ends_a_sweep_ends_its_workers(tmp_path, number):
    process = sweep_until_it_flies(tmp_path)
    left = workers(process.pid)
    assert len(left) == 2
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert err == f"uwirl: interrupted by {number.name}; the same command does what is left\n"
    deadline = time.monotonic() + 20.0
    while any(Path(f"/proc/{pid}").exists() for pid in left):
        assert time.monotonic() < deadline
        time.sleep(0.1)
