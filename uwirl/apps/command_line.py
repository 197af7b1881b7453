"""What every command does before Hydra takes over: help, and one message with exit code 2 for bad input."""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uwirl.config.checks import ConfigError
from uwirl.config.compose import composed, folder, searching
from uwirl.config.help import help_text
from uwirl.config.suggestions import did_you_mean, similar
from uwirl.config.sweeps import samples, space

BAD_CONFIGURATION = 2
FAILED = 1
PLACES = "hydra.run.dir=PATH, of a sweep hydra.sweep.dir=PATH"


def answer(program: str, name: str, check: Callable[[DictConfig], None]) -> None:
    """Answer --help and bad input, before any folder exists; return if Hydra is to run.

    Args:
        program: its name.
        name: of the primary configuration; its schema is registered.
        check: rules of what was composed; raises ValueError or OSError.

    Raises:
        SystemExit: 0 after help, BAD_CONFIGURATION after one message.
    """
    # Composing keeps nearly all that it makes: collecting garbage in between costs about 3 % and frees little.
    gc.disable()
    try:
        flags = read_flags(sys.argv[1:])
        if flags.help:
            give_help(program, name, flags)
        if is_hydras_affair(flags):
            return
        if is_sweep(flags):
            check_jobs(name, flags.overrides, flags.config_dir)
            return
        config = composed(name, flags.overrides, flags.config_dir)
        if not flags.cfg:
            check(config)
    except (ValueError, OSError) as error:
        say(program, error)
        sys.exit(BAD_CONFIGURATION)
    finally:
        gc.enable()


def give_help(program: str, name: str, flags: argparse.Namespace) -> NoReturn:
    """Print what --help prints, and exit."""
    with searching(flags.config_dir) as loader:
        code = tell(program, help_text(program, name, loader))
    sys.exit(code)


def is_hydras_affair(flags: argparse.Namespace) -> bool:
    """Whether something else than this configuration is shown or run."""
    others = (flags.hydra_help, flags.shell_completion, flags.experimental_rerun, flags.info)
    return any(others) or bool(flags.config_path or flags.config_name)


def is_sweep(flags: argparse.Namespace) -> bool:
    """Whether several jobs are asked for."""
    return flags.multirun or any(word.startswith("hydra.mode=") for word in flags.overrides)


def check_jobs(name: str, overrides: Sequence[str], config_dir: str | None) -> None:
    """Refuse names and types, which are those of every job of a sweep; a job that breaks a rule fails alone.

    Raises:
        ConfigError: the first of them.
    """
    words = [*space(name, overrides, config_dir), *overrides]
    with searching(config_dir) as loader:
        jobs = list(samples(words, loader))
    for job in jobs:
        composed(name, job, config_dir, ablation=False)


def read_flags(arguments: Sequence[str]) -> argparse.Namespace:
    """Hydra's flags and the overrides.

    Raises:
        ConfigError: a flag that Hydra does not know.
    """
    parser = get_args_parser()
    known = [flag for action in parser._actions for flag in action.option_strings]

    def refuse(message: str) -> None:
        raise ConfigError("command line", f"{message}; --help and --hydra-help list the flags")

    # Its own way out prints usage first.
    parser.error = refuse  # type: ignore[method-assign,assignment]
    flags, rest = parser.parse_known_args(list(arguments))
    for word in rest:
        if word.startswith("-"):
            raise ConfigError(word, f"no such flag{did_you_mean(similar(word, known))}; --hydra-help lists them")
        raise ConfigError(word, "stands behind a flag; write all of key=value together, flags before or after them")
    return flags


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
    with one_message(program), failed_jobs() as failures:

        @hydra.main(version_base="1.3", config_path=str(folder()), config_name=name)
        def task(composed: DictConfig) -> float | None:
            # Written first, so that a job that raises, which a search would go on after, has failed too.
            note = note_failure(failures)
            metrics = job(composed)
            if metrics["status"] != "complete":
                return None
            if note:
                note.unlink()
            return metrics.get("cost_total")

        task()
        failed = any(failures.iterdir())
    if failed:
        sys.exit(FAILED)


@contextmanager
def failed_jobs() -> Iterator[Path]:
    """A folder for a file of each failed job, by `note_failure`.

    A launcher may run a sweep's jobs in other processes of this machine, which share no variable with this one.
    """
    with tempfile.TemporaryDirectory(prefix="uwirl_") as folder:
        yield Path(folder)


def note_failure(folder: Path) -> Path | None:
    """Another file in the folder of failed jobs, named as none before; None on another machine, which has no such."""
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            return Path(file.name)
    except OSError:
        return None
