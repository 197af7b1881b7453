"""Hydra's flags, read before Hydra reads them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NoReturn

from uwirl.config.checks import ConfigError
from uwirl.config.suggestions import did_you_mean, similar

SWITCHES = {
    "--help": "-h",
    "--hydra-help": "",
    "--version": "",
    "--resolve": "",
    "--run": "-r",
    "--multirun": "-m",
    "--shell-completion": "-sc",
}
VALUES = {
    "--package": "-p",
    "--config-path": "-cp",
    "--config-name": "-cn",
    "--config-dir": "-cd",
    "--experimental-rerun": "",
}


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Its own way out would print usage first."""
        raise ConfigError("command line", f"{message}; --help and --hydra-help list the flags")


def read_flags(arguments: Sequence[str]) -> argparse.Namespace:
    """Hydra's flags, and the `overrides`.

    Raises:
        ConfigError: a flag that Hydra does not know.
    """
    parser = _Parser(add_help=False)
    parser.add_argument("overrides", nargs="*")
    for name, short in SWITCHES.items():
        parser.add_argument(*filter(None, (name, short)), action="store_true")
    for name, short in VALUES.items():
        parser.add_argument(*filter(None, (name, short)))
    parser.add_argument("--cfg", "-c", choices=["job", "hydra", "all"])
    # Of what it may show, Hydra knows more.
    parser.add_argument("--info", "-i", nargs="?", const="all")
    flags, rest = parser.parse_known_args(list(arguments))
    for word in rest:
        if word.startswith("-"):
            near = did_you_mean(similar(word, [*SWITCHES, *VALUES, "--cfg", "--info"]))
            raise ConfigError(word, f"no such flag{near}; --hydra-help lists them")
        raise ConfigError(word, "stands behind a flag; write all of key=value together, flags before or after them")
    return flags


def is_hydras_affair(flags: argparse.Namespace) -> bool:
    """Whether something else than this configuration is shown or run."""
    others = (flags.hydra_help, flags.version, flags.shell_completion, flags.experimental_rerun, flags.info)
    return any(others) or bool(flags.config_path or flags.config_name)


def is_sweep(flags: argparse.Namespace) -> bool:
    """Whether several jobs are asked for."""
    return flags.multirun or any(word.startswith("hydra.mode=") for word in flags.overrides)
