"""The runs of a sweep: their overrides, their results, and statistics over seeds."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from uwirl.snr.intervals import student_t
from uwirl.study.progress import bar
from uwirl.study.run_files import read_iterations
from uwirl.study.run_folder import read_metrics

# Metrics shown in tables and figures, if runs have them.
MAIN = (
    "cost_total",
    "capacity_final_mean_kbps",
    "capacity_final_kbps",
    "time_to_99_percent_s",
    "learning_vehicle_seconds",
    "learning_collisions",
    "collisions",
    "blocked",
    "reach_rate",
    "snr_map_rmse_dB",
    "converged",
)
MOST = 1e100
# Separates overrides in a folder's name; values may contain commas, too.
BETWEEN = re.compile(r",(?=[+~]{0,2}[A-Za-z_][\w@./]*=)")
# Subfolders of a run or a collection that contain no runs.
WITHIN = {"tb", "figures", "checkpoints"}
# Other files that are not reported: Hydra's, and those of a collection.
BESIDE = {"multirun.yaml", "results.csv", "results.md", "README.md"}


def as_number(value: Any) -> float | None:
    """A value as a number, with true = 1 and false = 0; None if it is none or too large to be squared."""
    return float(value) if isinstance(value, int | float) and abs(value) < MOST else None


def rounded(value: str) -> str:
    """A number with many decimals, as drawn by searches, rounded to four digits; other values unchanged."""
    try:
        text = f"{float(value):.4g}" if "." in value else value
    except ValueError:
        return value
    return min(value, text, key=len)


def told(keys: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Values of groups as labels; numbers are rounded if all groups remain different."""
    short = [tuple(map(rounded, key)) for key in keys]
    return short if len(set(short)) == len(keys) else list(keys)


@dataclass(frozen=True)
class Job:
    """A run that has ended.

    Attributes:
        name: its folder, relative to the collected one.
        overrides: its overrides, including the experiment if known.
        metrics: the other contents of metrics.json.
        learned: vehicle seconds and J of each policy iteration that was flown again, from iterations.csv.
    """

    name: str
    overrides: dict[str, str]
    metrics: dict[str, Any]
    learned: list[tuple[float, float]] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether the run ended well."""
        return self.metrics["status"] == "complete"

    def number(self, metric: str) -> float | None:
        """A metric's value; None if it is no number."""
        return as_number(self.metrics.get(metric))


@dataclass(frozen=True)
class Collection:
    """All runs below a folder.

    Attributes:
        jobs: runs that have ended.
        incomplete: folders of runs that are still running, or were killed.
        skipped: files and folders that are not runs, with reasons.
    """

    jobs: list[Job]
    incomplete: list[str]
    skipped: list[tuple[str, str]]

    @property
    def varied(self) -> list[str]:
        """Overrides, other than the seed, that differ between jobs."""
        keys = {key: None for job in self.jobs for key in job.overrides if key != "seed"}
        return [key for key in keys if len({job.overrides.get(key) for job in self.jobs}) > 1]

    @property
    def shared(self) -> dict[str, str]:
        """Overrides, other than the seed, that are the same in all jobs."""
        first = self.jobs[0].overrides if self.jobs else {}
        varied = {"seed", *self.varied}
        return {key: value for key, value in first.items() if key not in varied}

    def groups(self) -> dict[tuple[str, ...], list[Job]]:
        """Complete jobs, grouped by the varied overrides; groups with failed jobs only are empty.

        Each configuration is counted once: runs are repeatable, so a second run with the same configuration and seed
        would narrow the interval without adding information.
        """
        varied = self.varied
        groups: dict[tuple[str, ...], list[Job]] = {}
        seen = set()
        for job in self.jobs:
            key = tuple(job.overrides.get(name, "") for name in varied)
            group = groups.setdefault(key, [])
            identity = (key, repr(job.metrics.get("config_hash") or job.name), repr(job.metrics.get("seed")))
            if job.complete and identity not in seen:
                seen.add(identity)
                group.append(job)
        return groups


@dataclass(frozen=True)
class Interval:
    """Attributes:
    mean: mean of n numbers.
    half: half the width of its 95 % interval; None for a single number.
    n: at least 1.
    """

    mean: float
    half: float | None
    n: int

    def __str__(self) -> str:
        # A smaller spread is due to rounding.
        if self.half is None or self.half <= 1e-12 * abs(self.mean):
            return f"{self.mean:.5g}" if self.half is None else f"{self.mean:.5g} ± 0"
        if not 1e-6 <= self.half < 1e6:
            return f"{self.mean:.6g} ± {self.half:.2g}"
        decimals = max(0, 1 - math.floor(math.log10(self.half)))
        return f"{self.mean:.{decimals}f} ± {self.half:.{decimals}f}"


def interval(numbers: Sequence[float]) -> Interval | None:
    """Mean and its 95 % interval by Student's t; None without numbers."""
    n = len(numbers)
    if n == 0:
        return None
    mean = math.fsum(numbers) / n
    if n == 1:
        return Interval(mean, None, n)
    std = math.sqrt(math.fsum((x - mean) ** 2 for x in numbers) / (n - 1))
    return Interval(mean, _t(n - 1) * std / math.sqrt(n), n)


@cache
def _t(freedom: int) -> float:
    return student_t(0.95, freedom)


def numbers(jobs: Sequence[Job], metric: str) -> list[float]:
    """Values of a metric, for the jobs that have it."""
    return [x for job in jobs if (x := job.number(metric)) is not None]


def collect(folder: Path) -> Collection:
    """Read every metrics.json below a folder; unreadable files are skipped and listed.

    Args:
        folder: an existing folder.
    """
    found = Collection([], [], [])
    ended: list[Path] = []

    def unreadable(error: OSError) -> None:
        found.skipped.append((_name(folder, Path(error.filename)), error.strerror or "cannot be read"))

    for place, folders, files in os.walk(folder, onerror=unreadable):
        here = Path(place)
        inside = sorted(name for name in folders if name not in WITHIN and not name.startswith("."))
        if "metrics.json" in (*files, *inside):
            ended.append(here)
        elif "config.yaml" in files or "run.log" in files:
            found.incomplete.append(_name(folder, here))
        elif not files and not folders:
            found.skipped.append((_name(folder, here), "empty folder"))
        else:
            foreign = sorted(name for name in files if name not in BESIDE and not name.startswith("."))
            found.skipped.extend((_name(folder, here / name), "not of a run") for name in foreign)
        folders[:] = [name for name in inside if name != "metrics.json"]
    with bar("reading", len(ended)) as progress:
        for here in ended:
            _read(found, folder, here)
            progress.update()
    return found


def _read(found: Collection, folder: Path, here: Path) -> None:
    name = _name(folder, here)

    def skip(file: str, error: OSError | ValueError) -> None:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        found.skipped.append((_name(folder, here / file), reason or "cannot be read"))

    try:
        metrics = read_metrics(here)
    except (OSError, ValueError) as error:
        skip("metrics.json", error)
        return
    learned: list[tuple[float, float]] = []
    try:
        learned = read_iterations(here)
    except FileNotFoundError:
        # Only runs that learn have one.
        pass
    except (OSError, ValueError) as error:
        skip("iterations.csv", error)
    given = metrics.pop("overrides", None)
    # Runs of other versions do not record their overrides, but their folder names contain them.
    texts = given if isinstance(given, list) else BETWEEN.split(here.name) if "=" in here.name else []
    overrides = dict(_override(str(text)) for text in texts)
    if isinstance(metrics.get("experiment"), str):
        overrides = {"experiment": _writable(metrics["experiment"])} | overrides
    found.jobs.append(Job(name, overrides, metrics, learned))


def _override(text: str) -> tuple[str, str]:
    key, _, value = _writable(text).partition("=")
    return key.lstrip("+"), value


def _name(folder: Path, path: Path) -> str:
    relative = str(path.relative_to(folder)) if path != folder else path.resolve().name
    # Names that are not UTF-8 could not be written.
    return os.fsencode(relative).decode("utf-8", "backslashreplace")


def _writable(text: str) -> str:
    """Replace surrogate halves, which JSON may contain but text files may not."""
    return text.encode("utf-8", "backslashreplace").decode()
