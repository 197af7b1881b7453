"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import sys
from pathlib import Path

from omegaconf import DictConfig

from uwirl.apps.command_line import answer, launch, read_flags
from uwirl.config import compose
from uwirl.config.schema import register


def main() -> None:
    """Entry point. Exits 2, with one message and no run folder, on a bad configuration; 1 if a run failed."""
    register()
    answer("uwirl", "config", _check)
    # Imported here so that a typo is answered sooner.
    from uwirl.apps.job import run_job

    launch("uwirl", "config", run_job)


def _check(composed: DictConfig) -> None:
    """Refuse what cannot be run; a run that is resumed gets the command line that it began with."""
    from uwirl.config.validate import validate

    config = compose.to_config(composed)
    validate(config)
    if config.resume is None and config.init_from is None:
        return
    # These need torch, which reads checkpoints.
    from uwirl.apps.continuation import continued
    from uwirl.study import checkpoint, learning_file

    if config.resume is not None:
        flags = read_flags(sys.argv[1:])
        words = [word for word in sys.argv[1:] if word not in flags.overrides]
        sys.argv[1:] = [*words, *continued(flags.overrides, config, flags.config_dir)]
    else:
        learning_file.load(checkpoint.locate(Path(config.init_from or "")))


if __name__ == "__main__":
    main()
