"""`uwirl-collect`: what it writes, and that nothing it finds makes it stumble."""

import csv
import json
import os
import sys
from pathlib import Path

import pytest

from uwirl.apps import collect
from uwirl.study import collection_figure


@pytest.fixture
def run(monkeypatch):
    """run(folder): exit code."""

    def go(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["uwirl-collect", *arguments])
        with pytest.raises(SystemExit) as ended:
            collect.main()
        return ended.value.code

    return go


def add(folder: Path, **metrics) -> None:
    folder.mkdir(parents=True)
    (folder / "metrics.json").write_text(json.dumps({"status": "complete", "error": None} | metrics))


def test_table_is_printed_and_written(run, tmp_path, capsys):
    for seed in range(3):
        add(tmp_path / f"planner=pd,seed={seed}", cost_total=3.0 + 0.1 * seed)
    add(tmp_path / "planner=irl,seed=0", status="failed", error="DivergedError: no")
    (tmp_path / "planner=irl,seed=1").mkdir()
    (tmp_path / "planner=irl,seed=1" / "run.log").touch()
    assert run(str(tmp_path)) == 0
    out, err = capsys.readouterr()
    report = (tmp_path / "results.md").read_text()
    assert err == ""
    assert out.startswith(report)
    assert "3.10 ± 0.25" in report
    assert "- planner=irl, seed=0: DivergedError: no" in report
    assert "- planner=irl,seed=1\n" in report
    with (tmp_path / "results.csv").open(newline="") as file:
        assert [row["status"] for row in csv.DictReader(file)] == ["failed", "complete", "complete", "complete"]
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"boxes.png", "boxes.pdf"}
    # Again, beside its own files: the same.
    assert run(str(tmp_path)) == 0
    assert (tmp_path / "results.md").read_text() == report
    assert not list(tmp_path.rglob("*.tmp"))


def test_one_run_is_a_collection_too(run, tmp_path, capsys):
    add(tmp_path / "run", experiment="e", cost_total=3.0)
    assert run(str(tmp_path / "run")) == 0
    assert "1 complete, 0 failed, 0 incomplete." in capsys.readouterr().out


def test_sweep_that_has_only_begun(run, tmp_path, capsys):
    (tmp_path / "seed=0").mkdir()
    (tmp_path / "seed=0" / "config.yaml").touch()
    assert run(str(tmp_path)) == 0
    assert "0 complete, 0 failed, 1 incomplete." in capsys.readouterr().out


def test_no_such_folder(run, tmp_path, capsys):
    assert run(str(tmp_path / "none")) == 2
    assert capsys.readouterr().err == f"uwirl-collect: {tmp_path / 'none'}: no such folder\n"


def test_no_runs(run, tmp_path, capsys):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metrics.json").write_text("{")
    assert run(str(tmp_path)) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"uwirl-collect: {tmp_path}: no runs below it; skipped broken/metrics.json: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "results.md").exists()


def test_no_argument(run, capsys):
    assert run() == 2
    assert "the following arguments are required: folder" in capsys.readouterr().err


def test_without_matplotlib_there_are_tables(run, tmp_path, capsys, monkeypatch):
    add(tmp_path / "seed=0", cost_total=1.0)
    monkeypatch.setattr(collect.importlib.util, "find_spec", lambda name: None)
    assert run(str(tmp_path)) == 0
    assert "no figures: matplotlib is not installed" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results.csv", "results.md", "seed=0"]


def test_results_that_cannot_be_written(run, tmp_path, capsys):
    add(tmp_path / "seed=0", cost_total=1.0)
    (tmp_path / "results.csv.tmp").mkdir()
    assert run(str(tmp_path)) == 1
    out, err = capsys.readouterr()
    assert "1 complete" in out
    assert err == f"uwirl-collect: {tmp_path / 'results.csv'}: cannot be written: {os.strerror(21)}\n"
    assert not (tmp_path / "results.csv").exists()


def test_more_groups_than_can_be_told_apart_are_not_drawn(run, tmp_path, capsys):
    for k in range(collection_figure.MOST_GROUPS + 1):
        add(tmp_path / f"planner.gain={k}", cost_total=float(k))
    assert run(str(tmp_path)) == 0
    assert "no figures: more than 200 groups" in capsys.readouterr().out
    assert not (tmp_path / "figures").exists()
    assert len((tmp_path / "results.csv").read_text().splitlines()) == collection_figure.MOST_GROUPS + 2
