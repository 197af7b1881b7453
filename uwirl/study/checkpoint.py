"""Checkpoints: a plain dictionary, written whole or not at all, and verified before it is believed."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import warnings
from pathlib import Path
from typing import Any

import torch

FORMAT_VERSION = 1


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the message names the file."""


def _digest_file(path: Path) -> Path:
    return path.with_suffix(path.suffix + ".sha256")


def _replace(path: Path, content: bytes) -> None:
    """Write to a temporary file in the same folder, flush it to disk, then rename it over `path`."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def save(path: Path, content: dict[str, Any]) -> None:
    """Save tensors, numbers, strings, lists and dictionaries of them, with a sha256 beside the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    torch.save({"format_version": FORMAT_VERSION, **content}, buffer)
    data = buffer.getvalue()
    # The digest goes first: a crash between the two leaves a mismatch that is noticed, never a silent mix.
    _replace(_digest_file(path), f"{hashlib.sha256(data).hexdigest()}  {path.name}\n".encode())
    _replace(path, data)


def load(path: Path) -> dict[str, Any]:
    """Load a checkpoint.

    Raises:
        CheckpointError: missing, damaged, of another format, or holding anything but plain data.
    """
    try:
        data = path.read_bytes()
        digest = _digest_file(path).read_text().split()[0]
    except (OSError, IndexError) as error:
        raise CheckpointError(f"{path}: cannot be read ({error})") from error
    if hashlib.sha256(data).hexdigest() != digest:
        raise CheckpointError(f"{path}: damaged, its sha256 differs from the one beside it")
    try:
        with warnings.catch_warnings(action="ignore"):  # about pickles that are refused anyway
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # an unpickler fails in any way that foreign bytes can make it fail
        raise CheckpointError(f"{path}: no checkpoint of plain data") from error
    version = content.get("format_version") if isinstance(content, dict) else None
    if version != FORMAT_VERSION:
        raise CheckpointError(f"{path}: format version {version}, this program reads {FORMAT_VERSION}")
    return content
