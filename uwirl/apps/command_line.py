"""What every command does with bad input: one line on stderr, and an exit code."""

from __future__ import annotations

BAD_CONFIGURATION = 2
FAILED = 1


def one_line(error: BaseException) -> str:
    """The message, with the first line of what caused it, which is where Hydra puts the reason."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    cause = str(error.__cause__).splitlines()[:1] if error.__cause__ else []
    return "; ".join(lines + [line for line in cause if line not in lines])
