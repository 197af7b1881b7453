"""Files that are written completely or not at all, even if a run is killed or a disk is full."""

from __future__ import annotations

import errno
import io
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor


def write_whole(path: Path, content: bytes) -> None:
    """Write to a temporary file in the same folder, flush it to disk, then rename it over `path`.

    The temporary file always has the same name, so that the remains of a killed run are overwritten by the next.

    Raises:
        OSError: writing failed; the error names `path`.
    """
    temporary = path.with_name(path.name + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


def read_whole(path: Path, most_bytes: int) -> bytes:
    """Content of a regular file.

    Raises:
        OSError: the file cannot be read, is not a regular file (reading a pipe would block), or is too large.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        number = errno.EISDIR if stat.S_ISDIR(status.st_mode) else errno.EINVAL
        raise OSError(number, "Is a directory" if number == errno.EISDIR else "Not a regular file", str(path))
    if status.st_size > most_bytes:
        raise OSError(errno.EFBIG, "File too large", str(path))
    return path.read_bytes()


def write_arrays(path: Path, **arrays: Any) -> None:
    """Write named arrays, tensors of any device and numbers to a compressed .npz file."""
    buffer = io.BytesIO()
    here: dict[str, Any] = {name: x.numpy(force=True) if isinstance(x, Tensor) else x for name, x in arrays.items()}
    np.savez_compressed(buffer, **here)
    write_whole(path, buffer.getvalue())
