"""`uwirl`: estimate the channel, plan, evaluate; the settings are composed by Hydra."""

from __future__ import annotations

import argparse
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

from uwirl.apps.program import Program
from uwirl.config.checks import ConfigError
from uwirl.config.groups import for_what_is_named
from uwirl.config.schema import Config

log = logging.getLogger("uwirl")


class Run(Program):
    """Runs an experiment, unless it is a sweep's and has been done before."""

    name = "uwirl"
    files = ("resume", "init_from")

    def overrides(self, flags: argparse.Namespace) -> list[str]:
        """Without the default experiment where a scenario is named."""
        return for_what_is_named(flags.overrides)

    def prepare(self, config: Config, sweep: bool) -> tuple[Config, str]:
        """The settings, and the hash of a run with them."""
        # Imported here, and the like elsewhere, so that a typo is answered sooner.
        from uwirl.config.validate import validate

        validate(config)
        if config.resume is not None and sweep:
            raise ConfigError("resume", "continues one run at a time, as in `uwirl resume=PATH`")
        # These need torch, which reads checkpoints.
        from uwirl.runs.saving import Origin

        return config, Origin.of(config).config_hash(replace(config, resume=None))

    def final(self, config: Config, flags: argparse.Namespace) -> list[str]:
        """A run that is resumed gets the command line that it began with."""
        if config.resume is None:
            return flags.overrides
        from uwirl.apps.continuation import continued

        return continued(flags.overrides, config, flags.config_dir)

    def run(
        self, ready: tuple[Config, str], folder: Path, sweep: bool, experiment: str, overrides: list[str]
    ) -> dict[str, Any]:
        """Algorithm 1, from the beginning or from where it was interrupted."""
        from uwirl.runs import run as work
        from uwirl.runs.saving import unfinished
        from uwirl.study import run_folder

        config, config_hash = ready
        if sweep:
            if run_folder.is_complete(folder, config_hash):
                log.info("skipped: complete, in %s", folder)
                return run_folder.read_metrics(folder)
            left = unfinished(folder, config_hash)
            config = replace(config, resume=None if left is None else str(left))
        home = config.resume is not None and Path(config.resume).resolve().parent.parent == folder.resolve()
        if not sweep and not home:
            run_folder.check_free(folder, config)
        if config.resume is None:
            run_folder.clear(folder)
        return work.run(config, experiment, folder, overrides)


def main() -> None:
    """Entry point; see `Program.main`."""
    Run().main()


if __name__ == "__main__":
    main()
