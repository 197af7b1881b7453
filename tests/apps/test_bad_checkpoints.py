"""Checkpoints that no run can go on from: one line, nothing left behind."""

from __future__ import annotations

import pytest
import torch

from uwirl.apps.continuation import continued
from uwirl.apps.run import main
from uwirl.config.compose import compose
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError


@pytest.mark.parametrize("key", ["resume", "init_from"])
def test_missing_checkpoint_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, call, key):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        call(main, f"{key}=nowhere.pt")
    assert caught.value.code == 2
    assert capsys.readouterr().err == "uwirl: nowhere.pt: cannot be read (No such file or directory)\n"
    assert list(tmp_path.iterdir()) == []


def test_foreign_plain_data_is_no_run(tmp_path):
    checkpoint.save(tmp_path / "x.pt", {"actor": torch.zeros(1, 3)})
    with pytest.raises(CheckpointError, match=r"x\.pt: lacks config, config_hash, overrides"):
        continued([f"resume={tmp_path / 'x.pt'}"], compose([f"resume={tmp_path / 'x.pt'}"]))
