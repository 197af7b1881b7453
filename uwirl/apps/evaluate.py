"""`uwirl-evaluate checkpoint=PATH [overrides]`: what was learned, flown without learning, wherever overrides say."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from uwirl.apps.program import Program
from uwirl.config.groups import parsed
from uwirl.config.overrides import key_of, section_of, without
from uwirl.config.schema import Config, IrlConfig
from uwirl.config.validate import ConfigError, validate

# Settings of the run that the checkpoint is from which an evaluation has no use for.
UNUSED = ("resume", "init_from", "init_from_parts")
FOLDER = "hydra.run.dir='outputs/evaluation/${now:%Y-%m-%d_%H-%M-%S_%f}'"


class Evaluate(Program):
    """Flies a checkpoint's policy."""

    name = "uwirl-evaluate"
    files = ("checkpoint",)
    path = Path()

    def overrides(self, flags: argparse.Namespace) -> list[str]:
        """The settings of the checkpoint's run, with the others; the checkpoint is taken note of."""
        given = [word for word in flags.overrides if word.startswith("checkpoint=")]
        overrides = [word for word in flags.overrides if word not in given]
        if len(given) != 1 or given == ["checkpoint="]:
            raise ConfigError("checkpoint", "give one file or run folder, as in `uwirl-evaluate checkpoint=PATH`")
        # Imported here because they need torch.
        from uwirl.study import checkpoint, learning_file

        path = checkpoint.locate(Path(str(parsed(given[0]).value())))
        content = learning_file.load(path)
        for key in map(key_of, overrides):
            if key in UNUSED:
                raise ConfigError(key, "has no use in an evaluation, which learns nothing")
            if key == "planner":
                raise ConfigError(key, "is the one that learned the checkpoint's policy; fly others with `uwirl`")
        # Settings of a class that another takes the place of go with it.
        replaced = [section_of(word) for word in overrides if key_of(word).endswith(".target")]
        gone = [word for word in content["overrides"] if section_of(word) in replaced and ".settings" in key_of(word)]
        saved = [word for word in content["overrides"] if key_of(word) not in UNUSED and word not in gone]
        folder = [] if "hydra.run.dir" in map(key_of, overrides) else [FOLDER]
        self.path = path.resolve()
        return [*without(saved, overrides), *overrides, *folder]

    def prepare(self, config: Config, sweep: bool) -> Config:
        """The settings, if they are possible."""
        validate(config)
        assert isinstance(config.planner, IrlConfig)  # of which alone there are checkpoints
        return config

    def run(self, ready: Config, folder: Path, sweep: bool, experiment: str, overrides: list[str]) -> dict[str, Any]:
        """Fly, and judge the flight."""
        from uwirl.runs.run import evaluate
        from uwirl.study import checkpoint, run_folder

        if not sweep:
            run_folder.check_own(folder, run_folder.config_hash(ready, checkpoint.digest(self.path)))
        return evaluate(ready, experiment, folder, self.path)


def main() -> None:
    """Entry point; see `Program.main`."""
    Evaluate().main()


if __name__ == "__main__":
    main()
