"""Hydra's flags, read before Hydra reads them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NoReturn

from hydra._internal.utils import get_args_parser

from uwirl.config.checks import ConfigError
from uwirl.config.suggestions import did_you_mean, similar

# With these, something else than the configuration is shown or run.
HYDRAS = ("hydra_help", "shell_completion", "experimental_rerun", "info", "config_path", "config_name")


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Its own way out would print usage first."""
        raise ConfigError("command line", f"{message}; --help and --hydra-help list the flags")


def read_flags(arguments: Sequence[str]) -> argparse.Namespace:
    """Hydra's flags, and the `overrides`.

    Raises:
        ConfigError: a flag that Hydra does not know.
    """
    parser = _Parser(add_help=False, parents=[get_args_parser()])
    flags, rest = parser.parse_known_args(list(arguments))
    for word in rest:
        if word.startswith("-"):
            near = did_you_mean(similar(word, parser._option_string_actions))
            raise ConfigError(word, f"no such flag{near}; --hydra-help lists them")
        raise ConfigError(word, "stands behind a flag; write all of key=value together, flags before or after them")
    return flags
