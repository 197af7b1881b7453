"""Checkpoints that no run can go on from: one line that names the file, nothing left behind."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from uwirl.apps import evaluate, run
from uwirl.apps.continuation import continued
from uwirl.config.compose import compose
from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError

COMMANDS = [(run.main, "resume"), (run.main, "init_from"), (evaluate.main, "checkpoint")]


class Malicious:
    def __reduce__(self):
        return os.mkdir, ("made_by_a_checkpoint",)


def sealed(path: Path, data: bytes) -> None:
    """With the digest that fits, as somebody who means harm would."""
    path.write_bytes(data)
    path.with_suffix(".pt.sha256").write_text(f"{hashlib.sha256(data).hexdigest()}  {path.name}\n")


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda path: path.unlink(), "cannot be read (No such file or directory)"),
    "empty": (lambda path: path.write_bytes(b""), "damaged"),
    "text": (lambda path: sealed(path, b"hello"), "is none of uwirl's checkpoints"),
    "code": (lambda path: sealed(path, pickle.dumps(Malicious())), "is none of uwirl's checkpoints"),
    "alone": (lambda path: path.with_suffix(".pt.sha256").unlink(), "x.pt.sha256 is not beside it; copy it too"),
    "foreign and alone": (
        lambda path: (path.with_suffix(".pt.sha256").unlink(), path.write_text("hello")),
        "is none of uwirl's checkpoints",
    ),
    "of another": (lambda path: path.with_suffix(".pt.sha256").write_text("0" * 64), "damaged"),
    "endless": (huge, "cannot be read (File too large)"),
    "pipe": (lambda path: (path.unlink(), os.mkfifo(path)), "cannot be read (Not a regular file)"),
    "loop": (lambda path: (path.unlink(), path.symlink_to(path)), "cannot be read (Too many levels of symbolic links)"),
    "digest is a folder": (
        lambda path: (path.with_suffix(".pt.sha256").unlink(), path.with_suffix(".pt.sha256").mkdir()),
        "the sha256 beside it cannot be read",
    ),
    "foreign": (lambda path: checkpoint.save(path, {"actor": torch.zeros(1, 3)}), "lacks config"),
}


@pytest.mark.parametrize(("main", "key"), COMMANDS, ids=[key for _, key in COMMANDS])
@pytest.mark.parametrize("damage", DAMAGES)
def test_no_checkpoint_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, call, main, key, damage):
    monkeypatch.chdir(tmp_path)
    path = Path("x.pt")
    checkpoint.save(path, {"iteration": 1})
    do, why = DAMAGES[damage]
    do(path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(SystemExit) as caught:
        call(main, f"{key}={path}")
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert f": x.pt: {why}" in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("main", "key"), COMMANDS, ids=[key for _, key in COMMANDS])
def test_names_that_no_file_can_have(tmp_path, monkeypatch, capsys, call, main, key):
    monkeypatch.chdir(tmp_path)
    for name in ("", "x" * 300):
        with pytest.raises(SystemExit) as caught:
            call(main, f"{key}={name}")
        assert caught.value.code == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_foreign_plain_data_is_no_run(tmp_path):
    checkpoint.save(tmp_path / "x.pt", {"actor": torch.zeros(1, 3)})
    with pytest.raises(CheckpointError, match=r"x\.pt: lacks config, config_hash, overrides"):
        continued([f"resume={tmp_path / 'x.pt'}"], compose([f"resume={tmp_path / 'x.pt'}"]))
