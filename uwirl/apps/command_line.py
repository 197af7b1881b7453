"""What every command does with bad input: one line on stderr, and an exit code."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BAD_CONFIGURATION = 2
FAILED = 1


def one_line(error: BaseException) -> str:
    """The message, with the first line of what caused it, which is where Hydra puts the reason."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    cause = str(error.__cause__).splitlines()[:1] if error.__cause__ else []
    return "; ".join(lines + [line for line in cause if line not in lines])


@contextmanager
def failed_jobs() -> Iterator[Path]:
    """A folder for a file of each failed job, by `note_failure`.

    A launcher may run a sweep's jobs in other processes of this machine, which share no variable with this one.
    """
    with tempfile.TemporaryDirectory(prefix="uwirl_") as folder:
        yield Path(folder)


def note_failure(folder: Path) -> None:
    """Another file in the folder of failed jobs, named as none before."""
    tempfile.NamedTemporaryFile(dir=folder, delete=False).close()
