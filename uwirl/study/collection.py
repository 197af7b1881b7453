"""A sweep's runs read together: what each was given and gave, and statistics over seeds."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from uwirl.snr.intervals import student_t
from uwirl.study.run_folder import read_metrics

# Shown in tables and figures, where a run has them.
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
# Where one override ends and the next begins in a folder's name; values may hold commas too.
BETWEEN = re.compile(r",(?=[+~]{0,2}[A-Za-z_][\w@./]*=)")
# Folders of a run, and of a collection, that hold no runs.
WITHIN = {"tb", "figures", "checkpoints"}
# Files beside runs that need no mention: Hydra's, and a collection's.
BESIDE = {"multirun.yaml", "results.csv", "results.md", "README.md"}


def as_number(value: Any) -> float | None:
    """What is a number, true and false being 1 and 0; beyond MOST the squares of some would be none."""
    return float(value) if isinstance(value, int | float) and abs(value) < MOST else None


def rounded(value: str) -> str:
    """A number of many decimals, as searches draw them, to four digits; anything else as it is."""
    try:
        text = f"{float(value):.4g}" if "." in value else value
    except ValueError:
        return value
    return min(value, text, key=len)


def told(keys: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Values of groups, numbers rounded if that leaves all groups different."""
    short = [tuple(map(rounded, key)) for key in keys]
    return short if len(set(short)) == len(keys) else list(keys)


@dataclass(frozen=True)
class Job:
    """A run that ended.

    Attributes:
        name: its folder, below the one collected.
        overrides: what it was given, the experiment always among it where known.
        metrics: the contents of metrics.json but for these.
    """

    name: str
    overrides: dict[str, str]
    metrics: dict[str, Any]

    @property
    def complete(self) -> bool:
        return self.metrics["status"] == "complete"

    def number(self, metric: str) -> float | None:
        return as_number(self.metrics.get(metric))


@dataclass(frozen=True)
class Collection:
    """All that lies below a folder.

    Attributes:
        jobs: runs that ended.
        incomplete: folders of runs that are still going on, or were killed.
        skipped: what is no run, and why.
    """

    jobs: list[Job]
    incomplete: list[str]
    skipped: list[tuple[str, str]]

    @property
    def varied(self) -> list[str]:
        """Overrides, other than the seed, that are not the same in all jobs."""
        keys = {key: None for job in self.jobs for key in job.overrides if key != "seed"}
        return [key for key in keys if len({job.overrides.get(key) for job in self.jobs}) > 1]

    @property
    def shared(self) -> dict[str, str]:
        """Overrides, other than the seed, that are the same in all jobs."""
        first = self.jobs[0].overrides if self.jobs else {}
        varied = {"seed", *self.varied}
        return {key: value for key, value in first.items() if key not in varied}

    def groups(self) -> dict[tuple[str, ...], list[Job]]:
        """Complete jobs by the values of what is varied, a group for failed jobs too; each configuration once.

        A run is repeatable: a second one of the same configuration and seed would narrow an interval without telling
        anything.
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
    mean: of n numbers.
    half: half the width of its 95 % interval; None of a single number.
    n: at least 1.
    """

    mean: float
    half: float | None
    n: int

    def __str__(self) -> str:
        # Below this the spread is that of rounding.
        if self.half is None or self.half <= 1e-12 * abs(self.mean):
            return f"{self.mean:.5g}" if self.half is None else f"{self.mean:.5g} ± 0"
        if not 1e-6 <= self.half < 1e6:
            return f"{self.mean:.6g} ± {self.half:.2g}"
        decimals = max(0, 1 - math.floor(math.log10(self.half)))
        return f"{self.mean:.{decimals}f} ± {self.half:.{decimals}f}"


def interval(numbers: Sequence[float]) -> Interval | None:
    """Mean and its 95 % interval by Student's t; None of no numbers."""
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
    """A metric of those jobs that have it."""
    return [x for job in jobs if (x := job.number(metric)) is not None]


def collect(folder: Path) -> Collection:
    """Read every metrics.json below a folder; nothing that lies there can stop it.

    Args:
        folder: existing.
    """
    found = Collection([], [], [])

    def unreadable(error: OSError) -> None:
        found.skipped.append((_name(folder, Path(error.filename)), error.strerror or "cannot be read"))

    for place, folders, files in os.walk(folder, onerror=unreadable):
        here = Path(place)
        inside = sorted(name for name in folders if name not in WITHIN and not name.startswith("."))
        if "metrics.json" in (*files, *inside):
            _read(found, folder, here)
        elif "config.yaml" in files or "run.log" in files:
            found.incomplete.append(_name(folder, here))
        elif not files and not folders:
            found.skipped.append((_name(folder, here), "empty folder"))
        else:
            foreign = sorted(name for name in files if name not in BESIDE and not name.startswith("."))
            found.skipped.extend((_name(folder, here / name), "not of a run") for name in foreign)
        folders[:] = [name for name in inside if name != "metrics.json"]
    return found


def _read(found: Collection, folder: Path, here: Path) -> None:
    name = _name(folder, here)
    try:
        metrics = read_metrics(here)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        found.skipped.append((_name(folder, here / "metrics.json"), reason or "cannot be read"))
        return
    given = metrics.pop("overrides", None)
    # Runs of other versions do not tell, but their folders' names do.
    told = given if isinstance(given, list) else BETWEEN.split(here.name) if "=" in here.name else []
    overrides = dict(_override(str(text)) for text in told)
    if isinstance(metrics.get("experiment"), str):
        overrides = {"experiment": _writable(metrics["experiment"])} | overrides
    found.jobs.append(Job(name, overrides, metrics))


def _override(text: str) -> tuple[str, str]:
    key, _, value = _writable(text).partition("=")
    return key.lstrip("+"), value


def _name(folder: Path, path: Path) -> str:
    relative = str(path.relative_to(folder)) if path != folder else path.resolve().name
    # Names that are no UTF-8 could not be written.
    return os.fsencode(relative).decode("utf-8", "backslashreplace")


def _writable(text: str) -> str:
    """JSON may hold halves of signs, which are no text."""
    return text.encode("utf-8", "backslashreplace").decode()
