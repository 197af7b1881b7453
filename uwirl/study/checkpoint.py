"""Checkpoints: plain dictionaries, written atomically and verified when they are read."""

from __future__ import annotations

import hashlib
import io
import warnings
from pathlib import Path
from typing import Any

import torch

from uwirl.study.atomic_io import read_whole, write_whole

FORMAT_VERSION = 4
# A checkpoint of a few vehicles takes 0.1 MB, its digests 80 bytes each.
MOST_BYTES, MOST_DIGEST_BYTES = 2 * 10**9, 10**4
# Another process may be writing a new checkpoint while this one is read.
ATTEMPTS = 3


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the message names the file."""


def locate(path: Path) -> Path:
    """The checkpoint file for a path: for a run folder, its checkpoints/last.pt, or estimate.pt of `uwirl-estimate`.

    Raises:
        CheckpointError: the folder has no checkpoint, or the path is not a file name.
    """
    try:
        if not path.is_dir():
            return path
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from None
    file, estimate = path / "checkpoints" / "last.pt", path / "checkpoints" / "estimate.pt"
    if not file.is_file():
        if estimate.is_file():
            return estimate
        raise CheckpointError(
            f"{file}: there is no checkpoint; if the run ended before its first one, or was not one that learns, start "
            "it again with the command that started it"
        )
    return file


def _digest_file(path: Path) -> Path:
    return path.with_suffix(path.suffix + ".sha256")


def save(path: Path, content: dict[str, Any]) -> None:
    """Save tensors, numbers, strings, lists and dictionaries of them, with a sha256 in a second file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    torch.save({"format_version": FORMAT_VERSION, **content}, buffer)
    data = buffer.getvalue()
    line = f"{hashlib.sha256(data).hexdigest()}  {path.name}\n".encode()
    # If the process is killed in between, the digest file contains both digests, so old and new file are valid.
    present = _digest_file(path).read_bytes() if _digest_file(path).is_file() else b""
    write_whole(_digest_file(path), line + present)
    write_whole(path, data)
    write_whole(_digest_file(path), line)


def digest(path: Path) -> str:
    """sha256 of a checkpoint's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def load(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Load a checkpoint.

    Args:
        path: path of the file.
        device: device for its tensors.

    Raises:
        CheckpointError: the file is missing, damaged, of another format, or contains other than plain data.
    """
    for _ in range(ATTEMPTS):
        data, digests = _read(path)
        if hashlib.sha256(data).hexdigest() in digests:
            break
    else:
        raise CheckpointError(f"{path}: damaged, its sha256 differs from the one beside it")
    content = _plain(data)
    version = content.get("format_version") if isinstance(content, dict) else None
    if version is None:
        raise CheckpointError(f"{path}: is none of uwirl's checkpoints")
    if version != FORMAT_VERSION:
        raise CheckpointError(f"{path}: format version {version}, this program reads {FORMAT_VERSION}")
    # What a device cannot hold is no fault of the file.
    return content if device == "cpu" else torch.load(io.BytesIO(data), map_location=device, weights_only=True)


def _plain(data: bytes) -> Any:
    """Plain data as torch saves them; None for any others."""
    try:
        with warnings.catch_warnings(action="ignore"):  # warnings about pickles, which are refused anyway
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception:  # foreign bytes can raise any exception in the unpickler, whose message recommends to trust them
        return None


def _read(path: Path) -> tuple[bytes, list[str]]:
    """Content of a file, and the digests stored for it."""
    try:
        data = read_whole(path, MOST_BYTES)
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be read ({error.strerror})") from None
    beside = _digest_file(path)
    try:
        text = read_whole(beside, MOST_DIGEST_BYTES).decode()
    except FileNotFoundError:
        own = isinstance(content := _plain(data), dict) and "format_version" in content
        problem = f"{beside.name} is not beside it; copy it too" if own else "is none of uwirl's checkpoints"
        raise CheckpointError(f"{path}: {problem}") from None
    except (OSError, UnicodeDecodeError):
        raise CheckpointError(f"{path}: the sha256 beside it cannot be read") from None
    return data, [line.split()[0] for line in text.splitlines() if line.strip()]
