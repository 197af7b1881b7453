"""What a command says, and with which exit code it ends when something stops it."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

FAILED, BAD_CONFIGURATION = 1, 2
PLACES = "hydra.run.dir=PATH, of a sweep hydra.sweep.dir=PATH"


def say(program: str, error: BaseException | str) -> None:
    """One message on stderr."""
    print(f"{program}: {error}", file=sys.stderr)


def tell(program: str, text: str) -> int:
    """Print on stdout; returns the exit code. A reader that has seen enough, `head` perhaps, is no failure."""
    try:
        print(text, flush=True)
        return 0
    except OSError as error:
        # Python would flush once more on its way out.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0
        say(program, error)
        return FAILED


@contextmanager
def one_message(program: str) -> Iterator[None]:
    """Around Hydra: what stops it outside of a job is told in one message.

    Raises:
        SystemExit: BAD_CONFIGURATION where no folder can be made, FAILED, or that of a signal.
    """
    # Imported here, and the like elsewhere, so that bad input is answered sooner.
    from concurrent.futures import BrokenExecutor

    from uwirl.runs.interruption import Interrupted, Interruption

    # Or Hydra prints a traceback, and exits with 1, before anyone is asked.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        # A launcher whose own process is just killed leaves its workers behind.
        with Interruption():
            yield
        return
    except Interrupted as error:
        code, problem = error.exit_code, f"{error}; the same command does what is left"
    except BrokenExecutor:
        why = "a worker process was killed, perhaps for want of memory"
        code, problem = FAILED, f"{why}; the same command does what is left"
    except (HydraException, OmegaConfBaseException) as error:
        code, problem = BAD_CONFIGURATION, "; ".join(line.strip() for line in str(error).splitlines())
    except (OSError, ValueError) as error:
        # Logging wraps what its file could not be opened for.
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError):
            raise
        code, problem = FAILED, str(cause)
        if cause.filename is not None:
            code = BAD_CONFIGURATION
            problem = f"{cause.filename}: cannot be written ({cause.strerror}); choose another place: {PLACES}"
    say(program, problem)
    sys.exit(code)
