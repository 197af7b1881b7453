"""What every command does around Hydra: help, one message for bad input, and one for whatever stops it."""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import hydra
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uwirl.apps.flags import is_hydras_affair, is_sweep, read_flags
from uwirl.config.compose import composed, folder, searching
from uwirl.config.groups import Groups
from uwirl.config.help import help_text
from uwirl.config.sweeps import check_jobs

BAD_CONFIGURATION = 2
FAILED = 1
PLACES = "hydra.run.dir=PATH, of a sweep hydra.sweep.dir=PATH"

Rewrite = Callable[[argparse.Namespace], list[str]]


@contextmanager
def answering(program: str) -> Iterator[None]:
    """Before Hydra, and before any folder exists: bad input is told in one message.

    Raises:
        SystemExit: BAD_CONFIGURATION after a ValueError or an OSError.
    """
    # Composing keeps nearly all that it makes: collecting garbage in between costs about 3 % and frees little.
    gc.disable()
    try:
        yield
    except (ValueError, OSError) as error:
        say(program, error)
        sys.exit(BAD_CONFIGURATION)
    finally:
        gc.enable()


def checked(
    program: str,
    name: str,
    arguments: Sequence[str],
    check: Callable[[DictConfig, argparse.Namespace], list[str]],
    rewrite: Rewrite = lambda flags: flags.overrides,
) -> list[str]:
    """Answer --help, and look at what is to be run.

    Args:
        program: its name.
        name: of the primary configuration; its schema is registered.
        arguments: the command line.
        check: of what the overrides compose, not of a sweep; returns those that Hydra shall run with.
        rewrite: the overrides that flags and overrides stand for.

    Returns:
        The command line for Hydra.

    Raises:
        SystemExit: after help.
        ValueError, OSError: what is wrong.
    """
    flags = read_flags(arguments)
    if flags.help:
        with searching(flags.config_dir) as loader:
            code = tell(program, help_text(program, Groups(loader, name)))
        sys.exit(code)
    if is_hydras_affair(flags):
        return list(arguments)
    # Flags come before all overrides, or Hydra reads neither.
    words = [word for word in arguments if word not in flags.overrides]
    flags.overrides = rewrite(flags)
    if is_sweep(flags):
        check_jobs(name, flags.overrides, flags.config_dir)
        return [*words, *flags.overrides]
    config = composed(name, flags.overrides, flags.config_dir)
    return [*words, *(flags.overrides if flags.cfg else check(config, flags))]


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
    except Interrupted as error:
        say(program, f"{error}; the same command does what is left")
        sys.exit(error.exit_code)
    except BrokenExecutor:
        say(program, "a worker process was killed, perhaps for want of memory; the same command does what is left")
        sys.exit(FAILED)
    except (HydraException, OmegaConfBaseException) as error:
        say(program, "; ".join(line.strip() for line in str(error).splitlines()))
        sys.exit(BAD_CONFIGURATION)
    except (OSError, ValueError) as error:
        # Logging wraps what its file could not be opened for.
        cause = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(cause, OSError):
            raise
        if cause.filename is None:
            say(program, cause)
            sys.exit(FAILED)
        say(program, f"{cause.filename}: cannot be written ({cause.strerror}); choose another place: {PLACES}")
        sys.exit(BAD_CONFIGURATION)


def launch(program: str, name: str, job: Callable[[DictConfig], dict[str, Any]]) -> None:
    """Let Hydra compose and run one job, or those of a sweep.

    Args:
        program: its name.
        name: of the primary configuration.
        job: from what was composed to what metrics.json holds; a sweeper that searches makes its `cost_total` small.

    Raises:
        SystemExit: FAILED if a job has failed, and what `one_message` says.
    """
    with one_message(program), tempfile.TemporaryDirectory(prefix="uwirl_") as failures:

        @hydra.main(version_base="1.3", config_path=str(folder()), config_name=name)
        def task(composed: DictConfig) -> float | None:
            # Written first, so that a job that raises, which a search would go on after, has failed too.
            note = note_failure(Path(failures))
            metrics = job(composed)
            if metrics["status"] != "complete":
                return None
            if note:
                note.unlink()
            return metrics.get("cost_total")

        task()
        failed = os.listdir(failures)
    if failed:
        sys.exit(FAILED)


def note_failure(folder: Path) -> Path | None:
    """Another file in the folder of failed jobs, named as none before; None on another machine, which has no such.

    A launcher may run a sweep's jobs in other processes of this machine, which share no variable with this one.
    """
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            return Path(file.name)
    except OSError:
        return None
