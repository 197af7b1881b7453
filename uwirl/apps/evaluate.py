"""`uwirl-evaluate checkpoint=PATH [overrides]`: what was learned, flown without learning, wherever overrides say."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uwirl.apps.command_line import (
    BAD_CONFIGURATION,
    check_jobs,
    give_help,
    is_hydras_affair,
    is_sweep,
    launch,
    read_flags,
    say,
)
from uwirl.apps.job import in_folder
from uwirl.config import compose
from uwirl.config.overrides import key_of, section_of, unquoted, without
from uwirl.config.schema import Config, IrlConfig, register
from uwirl.config.validate import ConfigError, validate

# Settings of the run that the checkpoint is from which an evaluation has no use for.
UNUSED = ("resume", "init_from", "init_from_parts")
FOLDER = "hydra.run.dir='outputs/evaluation/${now:%Y-%m-%d_%H-%M-%S_%f}'"


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if the evaluation failed."""
    register()
    try:
        path, sys.argv[1:] = _checked(sys.argv[1:])
    except ValueError as error:
        say("uwirl-evaluate", error)
        sys.exit(BAD_CONFIGURATION)
    launch("uwirl-evaluate", "config", lambda composed: in_folder("uwirl-evaluate", partial(_job, composed, path)))


def _job(composed: DictConfig, path: Path, folder: Path, sweep: bool) -> dict[str, Any]:
    """Evaluate a checkpoint in a job's folder; returns what metrics.json holds."""
    from uwirl.runs.evaluation import run
    from uwirl.runs.refusal import write_refusal
    from uwirl.study import checkpoint, run_folder

    job = HydraConfig.get()
    experiment = str(job.runtime.choices["experiment"])
    try:
        compose.check_composed(composed, job.runtime.choices, GlobalHydra.instance().config_loader())
        config = _validated(compose.to_config(composed))
    except ConfigError as error:
        # One command line was checked before, so this is a job of a sweep.
        say("uwirl-evaluate", error)
        return write_refusal(folder, experiment, list(job.overrides.task), None, error)
    if not sweep:
        run_folder.check_own(folder, run_folder.config_hash(config, checkpoint.digest(path)))
    return run(config, experiment, folder, path)


def _checked(arguments: Sequence[str]) -> tuple[Path, list[str]]:
    """The checkpoint, and the command line that composes its run's settings with the overrides.

    Raises:
        CheckpointError, ConfigError: what is wrong.
    """
    flags = read_flags(arguments)
    given = [word for word in flags.overrides if word.startswith("checkpoint=")]
    overrides = [word for word in flags.overrides if word not in given]
    words = [word for word in arguments if word not in flags.overrides]
    if flags.help:
        give_help("uwirl-evaluate", "config", flags)
    if is_hydras_affair(flags):
        return Path(), list(arguments)
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
    composing = [*without(saved, overrides), *overrides]
    if is_sweep(flags):
        check_jobs("config", composing, flags.config_dir)
    else:
        _validated(compose.compose(composing, flags.config_dir))
    folder = [] if "hydra.run.dir" in map(key_of, overrides) else [FOLDER]
    return path.resolve(), [*words, *composing, *folder]


def _validated(config: Config) -> Config:
    validate(config)
    assert isinstance(config.planner, IrlConfig)  # of which alone there are checkpoints
    return config


if __name__ == "__main__":
    main()
