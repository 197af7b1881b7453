"""`uwirl-evaluate checkpoint=PATH [overrides]`: what was learned, flown without learning, wherever overrides say."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from uwirl.apps.command_line import answering, checked, launch
from uwirl.apps.job import Job, run_job
from uwirl.config import compose
from uwirl.config.overrides import key_of, section_of, unquoted, without
from uwirl.config.schema import Config, IrlConfig, register
from uwirl.config.validate import ConfigError, validate

PROGRAM = "uwirl-evaluate"
# Settings of the run that the checkpoint is from which an evaluation has no use for.
UNUSED = ("resume", "init_from", "init_from_parts")
FOLDER = "hydra.run.dir='outputs/evaluation/${now:%Y-%m-%d_%H-%M-%S_%f}'"


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if the evaluation failed."""
    register()
    with answering(PROGRAM):
        path, sys.argv[1:] = _checked(sys.argv[1:])
    launch(
        PROGRAM, "config", lambda composed: run_job(PROGRAM, composed, _validated, lambda c, job: _run(c, job, path))
    )


def _run(config: Config, job: Job, path: Path) -> dict[str, Any]:
    from uwirl.runs.evaluation import run
    from uwirl.study import checkpoint, run_folder

    if not job.sweep:
        run_folder.check_own(job.folder, run_folder.config_hash(config, checkpoint.digest(path)))
    return run(config, job.experiment, job.folder, path)


def _checked(arguments: Sequence[str]) -> tuple[Path, list[str]]:
    """The checkpoint, and the command line that composes its run's settings with the overrides.

    Raises:
        CheckpointError, ConfigError: what is wrong.
    """
    paths = [Path()]

    def rewrite(flags: argparse.Namespace) -> list[str]:
        paths[0], words = _with_settings(flags.overrides)
        return words

    def check(composed: DictConfig, flags: argparse.Namespace) -> list[str]:
        _validated(compose.to_config(composed))
        return flags.overrides

    line = checked(PROGRAM, "config", arguments, check, rewrite)
    return paths[0], line


def _with_settings(words: Sequence[str]) -> tuple[Path, list[str]]:
    """The checkpoint that overrides name, and its run's settings with the others."""
    given = [word for word in words if word.startswith("checkpoint=")]
    overrides = [word for word in words if word not in given]
    if len(given) != 1 or given == ["checkpoint="]:
        raise ConfigError("checkpoint", "give one file or run folder, as in `uwirl-evaluate checkpoint=PATH`")
    # Imported here because they need torch.
    from uwirl.study import checkpoint, learning_file

    path = checkpoint.locate(Path(unquoted(given[0].split("=", 1)[1])))
    content = learning_file.load(path)
    for override in overrides:
        if key_of(override) in UNUSED:
            raise ConfigError(key_of(override), "has no use in an evaluation, which learns nothing")
        if key_of(override) == "planner":
            raise ConfigError("planner", "is the one that learned the checkpoint's policy; fly others with `uwirl`")
    # Settings of a class that another takes the place of go with it.
    replaced = [section_of(word) for word in overrides if key_of(word).endswith(".target")]
    gone = [word for word in content["overrides"] if section_of(word) in replaced and ".settings" in key_of(word)]
    saved = [word for word in content["overrides"] if key_of(word) not in UNUSED and word not in gone]
    folder = [] if "hydra.run.dir" in map(key_of, overrides) else [FOLDER]
    return path.resolve(), [*without(saved, overrides), *overrides, *folder]


def _validated(config: Config, job: Job | None = None) -> Config:
    validate(config)
    assert isinstance(config.planner, IrlConfig)  # of which alone there are checkpoints
    return config


if __name__ == "__main__":
    main()
