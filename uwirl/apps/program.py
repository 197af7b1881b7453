"""What every command does: it answers help and bad input itself, then Hydra composes and runs its jobs."""

from __future__ import annotations

import argparse
import gc
import hashlib
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

import uwirl
from uwirl.apps.flags import HYDRAS, read_flags
from uwirl.apps.terminal import BAD_CONFIGURATION, FAILED, one_message, say, tell
from uwirl.config import compose
from uwirl.config.checks import ConfigError
from uwirl.config.estimate_schema import register
from uwirl.config.groups import Groups, with_path
from uwirl.config.help import help_text
from uwirl.config.suggestions import did_you_mean
from uwirl.config.sweeps import check_jobs

# File systems take 255.
MOST_BYTES = 200


def folder_name(overrides: str) -> str:
    """A job's folder below its sweep's: its overrides, or as much of them as a file system takes and a hash of all.

    Args:
        overrides: as Hydra joins them, sorted.
    """
    if not overrides:
        return "defaults"
    name = overrides.replace("/", "_").replace("\\", "_")
    if name == overrides and len(name.encode()) <= MOST_BYTES:
        return name
    digest = hashlib.sha256(overrides.encode()).hexdigest()[:12]
    return f"{name.encode()[: MOST_BYTES - 13].decode(errors='ignore')}_{digest}"


# At import, because another process of a sweep imports this module for its job and nothing else before Hydra asks.
OmegaConf.register_new_resolver("job_folder", folder_name, replace=True)


class Program:
    """A command.

    Attributes:
        name: as it is called.
        primary: its primary configuration.
        files: settings that may be meant by a word that is a path alone.
    """

    name: str
    primary = "config"
    files: Sequence[str] = ()

    def overrides(self, flags: argparse.Namespace) -> list[str]:
        """Those that compose the settings; raises ValueError or OSError where the command line says nothing useful."""
        return flags.overrides

    def prepare(self, config: Any, sweep: bool) -> Any:
        """From typed settings to what `run` takes; raises ValueError or OSError if they cannot be run."""
        raise NotImplementedError

    def final(self, config: Any, flags: argparse.Namespace) -> list[str]:
        """The overrides that Hydra shall run with, once they are known to be good."""
        return flags.overrides

    def run(self, ready: Any, folder: Path, sweep: bool, experiment: str, overrides: list[str]) -> dict[str, Any]:
        """Do the work of a job; returns what metrics.json holds.

        Args:
            ready: from `prepare`.
            folder: the job's, in which no other process is.
            sweep: whether the job is one of several.
            experiment: its name.
            overrides: that compose its settings.
        """
        raise NotImplementedError

    def main(self) -> None:
        """Exits 2, with one message and no run folder, on bad input; 1 if a job failed."""
        register()
        # Composing keeps nearly all that it makes: collecting garbage in between costs about 3 % and frees little.
        gc.disable()
        try:
            sys.argv[1:] = self.checked(sys.argv[1:])
        except (ValueError, OSError) as error:
            say(self.name, error)
            sys.exit(BAD_CONFIGURATION)
        finally:
            gc.enable()
        self.launch()

    def checked(self, arguments: Sequence[str]) -> list[str]:
        """Answer --help and --version, and look at what is to be run, before any folder exists.

        Args:
            arguments: the command line.

        Returns:
            That for Hydra.

        Raises:
            SystemExit: after either.
            ValueError, OSError: what is wrong.
        """
        flags = read_flags(arguments)
        if flags.version:
            sys.exit(tell(self.name, f"uwirl {uwirl.__version__}"))
        if flags.help:
            with compose.searching(flags.config_dir) as loader:
                code = tell(self.name, help_text(self.name, Groups(loader, self.primary)))
            sys.exit(code)
        if any(getattr(flags, name) for name in HYDRAS):
            return list(arguments)
        # Flags come before all overrides, or Hydra reads neither.
        words = [word for word in arguments if word not in flags.overrides]
        for word in flags.overrides:
            if os.path.lexists(word) or (Path(word).suffix and "=" not in word):
                raise ConfigError(word, f"is no setting{did_you_mean([f'{key}={word}' for key in self.files])}")
        flags.overrides = list(map(with_path, flags.overrides))
        flags.overrides = self.overrides(flags)
        if flags.multirun or any(word.startswith("hydra.mode=") for word in flags.overrides):
            check_jobs(self.primary, flags.overrides, flags.config_dir)
            return [*words, *flags.overrides]
        composed = compose.composed(self.primary, flags.overrides, flags.config_dir)
        if flags.cfg:
            return [*words, *flags.overrides]
        config = compose.to_object(composed)
        self.prepare(config, sweep=False)
        return [*words, *self.final(config, flags)]

    def launch(self) -> None:
        """Let Hydra compose and run one job, or those of a sweep.

        Raises:
            SystemExit: FAILED if a job has failed, and what `one_message` says.
        """
        with one_message(self.name), tempfile.TemporaryDirectory(prefix="uwirl_") as failures:

            @hydra.main(version_base="1.3", config_path=str(compose.folder()), config_name=self.primary)
            def task(composed: DictConfig) -> float | None:
                # Written first, so that a job that raises, which a search would go on after, has failed too.
                note = note_failure(Path(failures))
                metrics = self.job(composed)
                if metrics["status"] != "complete":
                    return None
                if note:
                    note.unlink()
                # What a sweeper that searches makes small.
                return metrics.get("cost_total")

            task()
            failed = os.listdir(failures)
        if failed:
            sys.exit(FAILED)

    def job(self, composed: DictConfig) -> dict[str, Any]:
        """Do what Hydra composed, in the folder that Hydra has made for it; returns what metrics.json holds.

        Raises:
            SystemExit: the folder of a single run is not free, or a signal came.
        """
        # Imported here so that a bad configuration is answered before torch is loaded.
        from uwirl.runs.interruption import Interrupted
        from uwirl.runs.recorded import write_refusal
        from uwirl.study import run_folder

        here = HydraConfig.get()
        folder, sweep, choices = Path(here.runtime.output_dir), here.mode is RunMode.MULTIRUN, here.runtime.choices
        experiment = str(choices.get("experiment", self.primary))
        overrides = [text for text in here.overrides.task if not text.startswith("resume=")]
        config = None
        try:
            with run_folder.held(folder):
                try:
                    config = compose.to_object(composed)
                    groups = Groups(GlobalHydra.instance().config_loader(), self.primary)
                    compose.check_composed(composed, choices, groups, here.overrides.task)
                    ready = self.prepare(config, sweep)
                except (ValueError, OSError) as error:
                    # One command line was checked before, so this is a job of a sweep.
                    say(self.name, error)
                    return write_refusal(folder, experiment, overrides, config, error)
                return self.run(ready, folder, sweep, experiment, overrides)
        except run_folder.FolderError as error:
            say(self.name, error)
            if not sweep:
                sys.exit(BAD_CONFIGURATION)
            return {"status": "failed", "error": str(error)}
        except Interrupted as interrupted:
            # Not only this job: who interrupts a sweep wants it to end.
            sys.exit(interrupted.exit_code)


def note_failure(folder: Path) -> Path | None:
    """Another file in the folder of failed jobs, named as none before; None on another machine, which has no such.

    A launcher may run a sweep's jobs in other processes of this machine, which share no variable with this one.
    """
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as file:
            return Path(file.name)
    except OSError:
        return None
