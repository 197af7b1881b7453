"""What may be resumed, from where, with which settings; what another run, or a refusal, leaves as it is."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from flights import SHORT, assert_same, go, uwirl

from uwirl.apps import continuation, evaluate
from uwirl.apps.continuation import continued
from uwirl.apps.run import main
from uwirl.config.checks import ConfigError
from uwirl.config.compose import compose
from uwirl.config.compose import folder as conf
from uwirl.runs import saving
from uwirl.runs.recorded import write_refusal
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError


def test_every_tells_how_often_it_is_saved(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(saving.Checkpoints, "last", lambda self, learning, state, *_: saved.append(state.flight.leg))
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
    assert result.stderr.count(" there, ") == 6
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

    def stop(self, learning, state, *rest):
        last(self, learning, state, *rest)
        saved.append(state.flight.leg)
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
