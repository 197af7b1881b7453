"""TensorBoard events of a run: weights during learning, and results; tags include units."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from omegaconf import OmegaConf
from torch.utils.tensorboard import SummaryWriter
from torch.utils.tensorboard.summary import hparams

from uwirl.config.schema import Config
from uwirl.motion.features import AXES, MotionBasis
from uwirl.motion.identification import Identified
from uwirl.motion.learning import IterationRecord
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.study.colours import colours_of
from uwirl.study.evaluation import Evaluation
from uwirl.study.shadowing import LinksAtMessages

# Metrics shown with the settings in parallel coordinates.
COMPARED = (
    "cost_total",
    "capacity_final_mean_kbps",
    "capacity_final_kbps",
    "time_to_99_percent_s",
    "learning_vehicle_seconds",
    "collisions",
    "learning_collisions",
    "energy_J",
)


class TensorBoard:
    """Writes the events of one run, and closes the files however the run ends.

    Args:
        folder: folder for the event files; None to write nothing.

    Attributes:
        continues: whether the folder already contains events of an interrupted run.
    """

    def __init__(self, folder: Path | None):
        self.continues = folder is not None and folder.exists()
        # On a full disk, the writer's own thread prints a traceback, and the same error is raised here again.
        self._before, threading.excepthook = threading.excepthook, _tell_all_but_os_errors
        self.writer: Any = _Nowhere() if folder is None else SummaryWriter(str(folder))

    def __enter__(self) -> TensorBoard:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self.writer.close()
        finally:
            threading.excepthook = self._before

    def flush(self) -> None:
        """Write buffered events, so that they are not lost if the run is killed."""
        self.writer.flush()

    def config(self, config: Config) -> None:
        """The resolved settings as text."""
        yaml = OmegaConf.to_yaml(OmegaConf.create(asdict(config)))
        self.writer.add_text("config", "\n".join(f"    {line}" for line in yaml.splitlines()))

    def estimate(self, estimate: ChannelEstimate) -> None:
        """Stage 1's parameters, one point for each vehicle."""
        for name, tag in zip(NAMES, ("K_dB", "n", "zeta2_dB2", "varphi_m", "rho2_dB2"), strict=True):
            for vehicle, (value, std, identifiable) in enumerate(zip(*estimate.parameter(name), strict=True)):
                if identifiable:
                    self.writer.add_scalar(f"snr/{tag}", value, vehicle)
                    self.writer.add_scalar(f"snr/{tag}_std", std, vehicle)

    def iteration(self, record: IterationRecord, basis: MotionBasis) -> None:
        """Weights of the first learner over policy iterations."""
        for name, value in zip(basis.critic_names, record.critic[0].tolist(), strict=True):
            self.writer.add_scalar(f"critic/W_{name}", value, record.iteration)
        groups = zip(AXES, basis.actor_names, strict=True)
        names = [f"{axis}/W_{name}" for axis, features in groups for name in features]
        for name, value in zip(names, record.actor[0].tolist(), strict=True):
            self.writer.add_scalar(f"actor_{name}", value, record.iteration)
        self.writer.add_scalar("learning/weight_change", record.weight_change, record.iteration)
        self.writer.add_scalar("learning/vehicle_seconds_s", record.seconds, record.iteration)

    def model(self, names: tuple[str, ...], known: Identified | None, seconds: float) -> None:
        """Parameters of a model learned in flight and their 95 % intervals, over vehicle time (step = s)."""
        for name, value, std in () if known is None else known.items(names):
            for suffix, number in (("", value), ("_low", value - 1.96 * std), ("_high", value + 1.96 * std)):
                self.writer.add_scalar(f"model/{name}{suffix}", number, round(seconds))

    def cost_per_iteration(self, cost: Sequence[float | None]) -> None:
        """J of each iterate that was flown again, from the mission's start."""
        for iteration, value in enumerate(cost, 1):
            if value is not None:
                self.writer.add_scalar("cost/total", value, iteration)

    def evaluation(self, evaluation: Evaluation, messages: LinksAtMessages, every: int = 10) -> None:
        """Capacity and clearance over the mission's time (step = ms), the cost by term, and the path in 3-D."""
        capacity, clearance = evaluation.chain_capacity[:, 0], evaluation.clearance[:, 0].amin(-1)
        for step in range(0, len(capacity), every):
            milliseconds = round(1000.0 * step * evaluation.trajectory.dt)
            self.writer.add_scalar("capacity/min_kbps", float(capacity[step]), milliseconds)
            if bool(clearance[step].isfinite()):
                self.writer.add_scalar("safety/min_clearance_m", float(clearance[step]), milliseconds)
        shadowed = messages.link_capacity.amin(-1)
        for time, value in zip(messages.time.tolist(), shadowed.tolist(), strict=True):
            self.writer.add_scalar("capacity/min_shadowed_kbps", value, round(1000.0 * time))
        for term, value in evaluation.cost_terms.items():
            self.writer.add_scalar(f"cost/{term}", float(value[0]), 0)
        path = evaluation.trajectory.eta[:, 0, :, :3].float().cpu()
        colours = torch.from_numpy((255.0 * colours_of(path.shape[1])).round()).to(torch.uint8)
        points = {"material": {"cls": "PointsMaterial", "size": 0.5}}
        self.writer.add_mesh("path", path.flatten(0, 1)[None], colours.repeat(len(path), 1)[None], config_dict=points)

    def picture(self, path: Path) -> None:
        """Add a figure drawn with matplotlib."""
        from matplotlib.image import imread

        self.writer.add_image(f"figures/{path.stem}", imread(path)[..., :3], dataformats="HWC")

    def compare(self, experiment: str, seed: int, overrides: Sequence[str], metrics: Mapping[str, Any]) -> None:
        """Write settings and results, to compare the runs of a sweep in parallel coordinates.

        The summaries are written one by one, because `SummaryWriter.add_hparams` would create a second run. Only some
        settings are included, because there are about a hundred; all of them are in the text `config`.

        Args:
            experiment: name of the experiment.
            seed: seed of the run.
            overrides: overrides as on the command line, key=value.
            metrics: results; those in COMPARED are shown.
        """
        pairs = (override.lstrip("+~").partition("=")[::2] for override in overrides)
        asked = {key: value for key, value in pairs if not key.startswith(("logging", "hydra"))}
        settings: dict[str, Any] = {key: _number_or_text(value) for key, value in asked.items()}
        # TensorBoard takes the columns for all runs from the first run that it finds; all runs have these.
        others = sorted(
            f"{key}={value}" for key, value in asked.items() if key not in ("experiment", "ablation", "seed")
        )
        settings |= {"experiment": experiment, "ablation": asked.get("ablation", "none"), "seed": seed}
        settings["overrides"] = " ".join(others)
        results = {name: metrics[name] for name in COMPARED if isinstance(metrics.get(name), (int, float))}
        for summary in hparams(settings, {f"result/{name}": value for name, value in results.items()}):
            self.writer._get_file_writer().add_summary(summary)
        for name, value in results.items():
            self.writer.add_scalar(f"result/{name}", value, 0)


def _tell_all_but_os_errors(failure: threading.ExceptHookArgs) -> None:
    if not issubclass(failure.exc_type, OSError):
        threading.__excepthook__(failure)


class _Nowhere:
    """A writer that writes nothing."""

    def __getattr__(self, name: str) -> Callable[..., _Nowhere]:
        return lambda *args, **kwargs: self


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value
