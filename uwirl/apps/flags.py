"""Hydra's flags, read before Hydra reads them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from uwirl.config.checks import ConfigError
from uwirl.config.suggestions import did_you_mean, similar

SWITCH: dict[str, Any] = {"action": "store_true"}
FLAGS: dict[tuple[str, ...], dict[str, Any]] = {
    ("--help", "-h"): SWITCH,
    ("--hydra-help",): SWITCH,
    ("--version",): SWITCH,
    ("--cfg", "-c"): {"choices": ["job", "hydra", "all"]},
    ("--resolve",): SWITCH,
    ("--package", "-p"): {},
    ("--run", "-r"): SWITCH,
    ("--multirun", "-m"): SWITCH,
    ("--shell-completion", "-sc"): SWITCH,
    ("--config-path", "-cp"): {},
    ("--config-name", "-cn"): {},
    ("--config-dir", "-cd"): {},
    ("--experimental-rerun",): {},
    ("--info", "-i"): {"nargs": "?", "const": "all"},
}
# With these, something else than the configuration is shown or run.
HYDRAS = ("hydra_help", "version", "shell_completion", "experimental_rerun", "info", "config_path", "config_name")


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
    for names, options in FLAGS.items():
        parser.add_argument(*names, **options)
    flags, rest = parser.parse_known_args(list(arguments))
    for word in rest:
        if word.startswith("-"):
            near = did_you_mean(similar(word, [name for names in FLAGS for name in names]))
            raise ConfigError(word, f"no such flag{near}; --hydra-help lists them")
        raise ConfigError(word, "stands behind a flag; write all of key=value together, flags before or after them")
    return flags
