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


def saved_with_code(path: Path) -> None:
    """As `save` would write it."""
    torch.save({"format_version": checkpoint.FORMAT_VERSION, "actor": Malicious()}, path)
    sealed(path, path.read_bytes())


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
        lambda path: path.write_bytes(b"hello"),
        flip,
        lambda path: path.with_suffix(".pt.sha256").unlink(),
        lambda path: path.with_suffix(".pt.sha256").write_bytes(b""),
        lambda path: path.with_suffix(".pt.sha256").write_bytes(b"\xff\xfe"),
        lambda path: sealed(path, b""),
        lambda path: sealed(path, path.read_bytes()[:100]),
        lambda path: sealed(path, b"hello"),
        lambda path: sealed(path, pickle.dumps(Malicious())),
        lambda path: sealed(path, pickle.dumps([1, 2, 3], protocol=2)),
        saved_with_code,
    ],
    ids=[
        *("missing", "empty", "cut", "text", "flipped bit", "no digest", "empty digest", "foreign digest"),
        *("sealed empty", "sealed cut", "sealed text", "sealed code", "sealed list", "code in a checkpoint"),
    ],
)
def test_damage_is_one_error_that_names_the_file(saved, damage):
    damage(saved)
    with pytest.raises(CheckpointError, match=r"^\S+last\.pt: ") as caught:
        checkpoint.load(saved)
    assert "weights_only" not in str(caught.value)
    # Nor what torch would advise: to load it without protection.
    assert caught.value.__cause__ is None
    assert not Path("/tmp/uwirl_was_here").exists()


def test_any_flipped_byte_is_noticed(saved):
    data = saved.read_bytes()
    for k in range(0, len(data), 97):
        saved.write_bytes(data[:k] + bytes([data[k] ^ 0x80]) + data[k + 1 :])
        with pytest.raises(CheckpointError, match="damaged"):
            checkpoint.load(saved)


@pytest.mark.parametrize("moment", range(3))
@pytest.mark.parametrize("renamed", [False, True])
def test_killed_in_the_middle_of_a_save_there_is_the_old_checkpoint_or_the_new(saved, monkeypatch, moment, renamed):
    """Before or after each of the three files is put in place, as a kill leaves it: nothing is tidied up."""
    replace, moments = os.replace, iter(range(3))

    def killed(source, target):
        if next(moments) != moment:
            return replace(source, target)
        if renamed:
            replace(source, target)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", killed)
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: None)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(saved, {"iteration": 8})
    monkeypatch.undo()
    assert checkpoint.load(saved)["iteration"] == (8 if (moment, renamed) >= (1, True) else 7)
    # The next save leaves nothing of it.
    checkpoint.save(saved, {"iteration": 9})
    assert checkpoint.load(saved)["iteration"] == 9
    assert sorted(path.name for path in saved.parent.iterdir()) == ["last.pt", "last.pt.sha256"]
    assert len(saved.with_suffix(".pt.sha256").read_text().splitlines()) == 1


def test_replaced_while_it_is_read_it_is_the_new_one(saved, monkeypatch):
    """The run saves again after the file was read, and before its digest is."""
    read, saves = checkpoint.read_whole, iter([{"iteration": 8}])

    def interleaved(path, most_bytes):
        data = read(path, most_bytes)
        for content in saves:
            checkpoint.save(saved, content)
        return data

    monkeypatch.setattr(checkpoint, "read_whole", interleaved)
    assert checkpoint.load(saved)["iteration"] == 8


def test_a_run_folder_stands_for_its_last_checkpoint(saved):
    assert checkpoint.locate(saved.parents[1]) == saved
    assert checkpoint.locate(saved) == saved


def test_a_run_folder_without_checkpoint_says_how_to_start_again(tmp_path):
    with pytest.raises(CheckpointError, match=r"last\.pt: there is no checkpoint; .* start it again"):
        checkpoint.locate(tmp_path)


def test_future_format_is_refused(saved, monkeypatch):
    monkeypatch.setattr(checkpoint, "FORMAT_VERSION", 99)
    checkpoint.save(saved, CONTENT)
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="format version 99"):
        checkpoint.load(saved)
