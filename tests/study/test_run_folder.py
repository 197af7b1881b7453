"""Whose a run folder is, and whether what it holds is what is wanted."""

import json
import os
import subprocess
import sys

import pytest
import torch

from uwirl.motion.learning import IterationRecord
from uwirl.study import run_files, run_folder
from uwirl.study.run_folder import FolderError, held


def write(folder, text: str):
    (folder / "metrics.json").write_text(text)


def another(folder):
    return pytest.raises(FolderError, match=f"^hydra.run.dir: {folder} holds another run, and is left as it is$")


@pytest.mark.parametrize("group", ["experiment=fig6_pair", "experiment=random_layouts", "ablation=unbounded"])
def test_folder_is_one_configurations(make_config, tmp_path, group: str):
    mine, other = make_config(group), make_config(group, "seed=1")
    run_folder.check_free(tmp_path, mine)
    run_folder.write_config(tmp_path, mine)
    run_folder.check_free(tmp_path, mine)
    run_folder.check_free(tmp_path, make_config(group, "logging.figures=false"))
    with another(tmp_path):
        run_folder.check_free(tmp_path, other)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"a: [", b"\xff\xfe\x00", b"a: ${nowhere}", b"3"])
def test_damaged_configuration_is_anothers(make_config, tmp_path, content: bytes):
    (tmp_path / "config.yaml").write_bytes(content)
    with another(tmp_path):
        run_folder.check_free(tmp_path, make_config())
    assert (tmp_path / "config.yaml").read_bytes() == content


def test_configuration_with_code_in_it_is_anothers_and_does_not_run(make_config, tmp_path):
    (tmp_path / "config.yaml").write_text(f"!!python/object/apply:os.mkdir ['{tmp_path / 'made'}']")
    with another(tmp_path):
        run_folder.check_free(tmp_path, make_config())
    assert not (tmp_path / "made").exists()


def test_a_run_without_settings_is_anothers(make_config, tmp_path):
    """An experiment's script leaves such."""
    run_folder.write_metrics(tmp_path, {"status": "complete"})
    with pytest.raises(run_folder.FolderError, match="holds another run"):
        run_folder.check_free(tmp_path, make_config())


def test_iterations_are_a_row_each(tmp_path):
    """Before the missions without J, after them with J where an iterate was flown again; what is not known is empty."""
    weights = torch.ones(1, 3)
    records = [
        IterationRecord(1, 19.0, weights, weights, 0.5, False, 90, False, 0.25, 1e7),
        IterationRecord(2, 24.0, weights, weights, 1e-4, True, 180, True),
    ]
    run_files.write_iterations(tmp_path, records)
    path = tmp_path / "iterations.csv"
    assert path.read_text() == (
        "iteration,vehicle_seconds,rows,weight_change,bellman_residual,condition_number,cost_total,converged\n"
        "1,19,90,0.5,0.25,10000000,,0\n"
        "2,24,180,0.0001,,,,1\n"
    )
    run_files.write_iterations(tmp_path, records, [None, 3.25])
    rows = [line.split(",") for line in path.read_text().splitlines()]
    assert [row[6] for row in rows] == ["cost_total", "", "3.25"]
    assert os.listdir(tmp_path) == ["iterations.csv"]


def test_own_is_what_says_so(tmp_path):
    run_folder.check_own(tmp_path, "mine")
    write(tmp_path, '{"status": "failed", "config_hash": "mine"}')
    run_folder.check_own(tmp_path, "mine")
    with another(tmp_path):
        run_folder.check_own(tmp_path, "other")
    # Killed, so nobody knows whose it is.
    (tmp_path / "config.yaml").touch()
    (tmp_path / "metrics.json").unlink()
    with another(tmp_path):
        run_folder.check_own(tmp_path, "mine")


def test_folder_is_held_by_one_process(tmp_path):
    program = "import sys; from pathlib import Path; from uwirl.study.run_folder import held\n"
    program += "with held(Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", program, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(FolderError, match=f"^{tmp_path}: another process is running in it"), held(tmp_path):
            pass
        process.kill()
    with held(tmp_path):
        pass


def test_metrics_that_cannot_be_written_are_a_failure(tmp_path):
    (tmp_path / "metrics.json").mkdir()
    metrics = {"status": "complete", "error": None}
    run_folder.close(tmp_path, metrics)
    assert metrics["status"] == "failed"
    assert metrics["error"] == f"IsADirectoryError: [Errno 21] Is a directory: '{tmp_path / 'metrics.json'}'"


def test_complete_means_this_configuration(make_config, tmp_path):
    config = make_config()
    wanted_hash = run_folder.config_hash(config)
    metrics = {"status": "complete", "config_hash": wanted_hash}
    assert not run_folder.is_complete(tmp_path, wanted_hash)
    for wanted, changed in [(True, {}), (False, {"status": "failed"}), (False, {"config_hash": "0"})]:
        write(tmp_path, json.dumps(metrics | changed))
        assert run_folder.is_complete(tmp_path, wanted_hash) is wanted
    write(tmp_path, json.dumps(metrics)[:-5])
    assert not run_folder.is_complete(tmp_path, wanted_hash)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"status": "done"}', "\x00", "[" * 100_000])
def test_what_is_no_runs_metrics(tmp_path, text: str):
    write(tmp_path, text)
    with pytest.raises(ValueError, match=r"."):
        run_folder.read_metrics(tmp_path)


def test_clearing_leaves_what_is_not_a_runs(tmp_path):
    for name in ("metrics.json", "trajectory.npz", "run.log", "notes.txt"):
        (tmp_path / name).write_text("{}")
    (tmp_path / "tb").mkdir()
    (tmp_path / "tb" / "events").touch()
    run_folder.clear(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "run.log"]
    run_folder.clear(tmp_path)


def test_clearing_spares_folders_that_no_run_has_been_in(make_config, tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "own.png").touch()
    run_folder.check_free(tmp_path, make_config())
    run_folder.clear(tmp_path)
    assert (tmp_path / "figures" / "own.png").exists()
