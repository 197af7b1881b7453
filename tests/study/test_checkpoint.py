"""Checkpoints: whole or not at all, verified, plain data only."""

import hashlib
import os
import pickle
from pathlib import Path

import pytest
import torch

from uwirl.study import checkpoint
from uwirl.study.checkpoint import CheckpointError

CONTENT = {"actor": torch.arange(6.0).view(2, 3), "iteration": 7, "config": {"seed": 0, "R": [0.1, 0.2]}, "name": "x"}


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "checkpoints" / "last.pt"
    checkpoint.save(path, CONTENT)
    return path


def test_what_was_saved_comes_back(saved):
    content = checkpoint.load(saved)
    torch.testing.assert_close(content.pop("actor"), CONTENT["actor"], rtol=0, atol=0)
    assert content.pop("format_version") == checkpoint.FORMAT_VERSION
    assert content == {key: value for key, value in CONTENT.items() if key != "actor"}


def test_only_file_and_digest_remain(saved):
    assert sorted(path.name for path in saved.parent.iterdir()) == ["last.pt", "last.pt.sha256"]


def test_a_failing_write_leaves_the_old_checkpoint(saved, monkeypatch):
    def full_disk(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match="No space left"):
        checkpoint.save(saved, {"iteration": 8})
    assert checkpoint.load(saved)["iteration"] == 7
    assert len(list(saved.parent.iterdir())) == 2


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


class Malicious:
    def __reduce__(self):
        return os.system, ("touch /tmp/uwirl_was_here",)


def sealed(path: Path, data: bytes) -> None:
    """Replace the content and make the digest fit, as somebody who means harm would."""
    path.write_bytes(data)
    path.with_suffix(".pt.sha256").write_text(f"{hashlib.sha256(data).hexdigest()}  {path.name}\n")


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.unlink(),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(path.read_bytes()[:100]),
        flip,
        lambda path: path.with_suffix(".pt.sha256").unlink(),
        lambda path: sealed(path, b"hello"),
        lambda path: sealed(path, pickle.dumps(Malicious())),
    ],
    ids=["missing", "empty", "cut", "flipped bit", "no digest", "text", "code"],
)
def test_damage_is_one_error_that_names_the_file(saved, damage):
    damage(saved)
    with pytest.raises(CheckpointError, match=r"last\.pt"):
        checkpoint.load(saved)
    assert not Path("/tmp/uwirl_was_here").exists()


def test_future_format_is_refused(saved, monkeypatch):
    monkeypatch.setattr(checkpoint, "FORMAT_VERSION", 99)
    checkpoint.save(saved, CONTENT)
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="format version 99"):
        checkpoint.load(saved)
