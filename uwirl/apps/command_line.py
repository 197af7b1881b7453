"""What every command does before Hydra takes over: help, and one message with exit code 2 for bad input."""

from __future__ import annotations

import argparse
import gc
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hydra._internal.utils import get_args_parser
from omegaconf import DictConfig

from uwirl.config.checks import ConfigError
from uwirl.config.compose import composed, searching
from uwirl.config.help import help_text
from uwirl.config.suggestions import did_you_mean, similar
from uwirl.config.sweeps import samples, space

BAD_CONFIGURATION = 2
FAILED = 1


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
            with searching(flags.config_dir) as loader:
                print(help_text(program, name, loader))
            sys.exit(0)
        # What shows, or runs, something else than this configuration is Hydra's affair.
        others = (flags.hydra_help, flags.shell_completion, flags.experimental_rerun, flags.info)
        if any(others) or flags.config_path or flags.config_name:
            return
        if flags.multirun or any(word.startswith("hydra.mode=") for word in flags.overrides):
            # Names and types are those of every job; a job that breaks a rule fails alone.
            words = [*space(name, flags.overrides, flags.config_dir), *flags.overrides]
            with searching(flags.config_dir) as loader:
                jobs = list(samples(words, loader))
            for job in jobs:
                composed(name, job, flags.config_dir, ablation=False)
            return
        config = composed(name, flags.overrides, flags.config_dir)
        if not flags.cfg:
            check(config)
    except (ValueError, OSError) as error:
        say(program, error)
        sys.exit(BAD_CONFIGURATION)
    finally:
        gc.enable()


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


def say(program: str, error: BaseException) -> None:
    """One message on stderr."""
    print(f"{program}: {error}", file=sys.stderr)


@contextmanager
def failed_jobs() -> Iterator[Path]:
    """A folder for a file of each failed job, by `note_failure`.

    A launcher may run a sweep's jobs in other processes of this machine, which share no variable with this one.
    """
    with tempfile.TemporaryDirectory(prefix="uwirl_") as folder:
        yield Path(folder)


def note_failure(folder: Path) -> Path:
    """Another file in the folder of failed jobs, named as none before."""
    with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
        return Path(file.name)
