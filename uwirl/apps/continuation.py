"""From the command line of a resumed or evaluated run to the one that composes its settings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from uwirl.config import compose
from uwirl.config.overrides import FREE, key_of, quoted, section_of, without
from uwirl.config.schema import Config
from uwirl.config.validate import validate
from uwirl.study import checkpoint, learning_file
from uwirl.study.checkpoint import CheckpointError

ABSENT = "absent"


def continued(arguments: Sequence[str], config: Config, config_dir: str | None = None) -> list[str]:
    """The command line, without flags, that continues a run in its own folder.

    Args:
        arguments: the command line; but for those of FREE it says nothing, or the same as the run's.
        config: what it composes, with `resume`.
        config_dir: a folder of the user's own files.

    Raises:
        CheckpointError: the checkpoint cannot be used, or the settings are not the run's; each difference is listed.
        ConfigError: the run's settings are no longer possible.
    """
    path = checkpoint.locate(Path(config.resume or ""))
    content, path = learning_file.load(path), path.resolve()
    own = [argument for argument in arguments if section_of(argument) not in (*FREE, "hydra")]
    here = config if own else compose.compose(content["overrides"], config_dir)
    validate(here)
    found = [f"{key} = {a} there, {b} here" for key, a, b in differences(content["config"], asdict(here))]
    if found:
        why = "leave them out to continue it" if own else "the program's defaults have changed since"
        raise CheckpointError(f"resume: {path} was run with other settings ({why}): {'; '.join(found)}")
    free = [a for a in arguments if section_of(a) in FREE and key_of(a) != "resume"]
    hydra = [argument for argument in arguments if section_of(argument) == "hydra"]
    if "hydra.run.dir" not in map(key_of, hydra):
        if path.parent.name != "checkpoints":
            raise CheckpointError(
                f"resume: {path} lies in no run folder; say where to continue with hydra.run.dir=PATH"
            )
        hydra.append(f"hydra.run.dir={quoted(path.parents[1])}")
    return [*without(content["overrides"], free), *free, f"resume={quoted(path)}", *hydra]


def differences(there: dict[str, Any], here: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Key, value there and value here, wherever two configurations differ in what changes the result."""
    a, b = dict(_flat(there)), dict(_flat(here))
    for key in a | b:
        x, y = a.get(key, ABSENT), b.get(key, ABSENT)
        if x != y and section_of(key) not in FREE:
            yield key, x, y


def _flat(tree: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value
