"""results.csv and results.md of a collection."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from typing import Any

from uwirl.study.collection import MAIN, Collection, Job, interval, numbers, told

# Largest number of skipped files that are listed.
MOST_SKIPPED = 20


def csv_table(collection: Collection) -> str:
    """A row for each job: its folder, overrides, status, error, then all metrics, lists as JSON."""
    overrides = list(dict.fromkeys(key for job in collection.jobs for key in job.overrides))
    known = dict.fromkeys(key for job in collection.jobs for key in job.metrics)
    # The seed is a metric of every run, and already a column if it is an override.
    metrics = [key for key in known if key not in (*overrides, "job", "status", "error")]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["job", *overrides, "status", "error", *metrics])
    for job in collection.jobs:
        given = [job.overrides.get(key, job.metrics.get(key)) for key in overrides]
        gave = [job.metrics.get(key) for key in ("status", "error", *metrics)]
        table.writerow([job.name, *map(_cell, [*given, *gave])])
    return text.getvalue()


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value)


def markdown(collection: Collection, title: str) -> str:
    """Means with 95 % intervals by the overrides other than the seed; failed, incomplete and skipped jobs."""
    failed = [job for job in collection.jobs if not job.complete]
    complete = len(collection.jobs) - len(failed)
    lines = [
        f"# {title}",
        "",
        f"{complete} complete, {len(failed)} failed, {len(collection.incomplete)} incomplete.",
    ]
    if collection.shared:
        lines += ["", "All with " + ", ".join(f"`{key}={value}`" for key, value in collection.shared.items()) + "."]
    if complete:
        lines += ["", *_groups(collection)]
    if failed:
        lines += ["", "## Failed", "", *(f"- {short(collection, job)}: {_line(_error(job))}" for job in failed)]
    if collection.incomplete:
        lines += ["", "## Incomplete: still running, or killed", "", *(f"- {name}" for name in collection.incomplete)]
    if collection.skipped:
        shown = collection.skipped[:MOST_SKIPPED]
        lines += ["", "## Skipped", "", *(f"- {name}: {_line(reason)}" for name, reason in shown)]
        if len(shown) < len(collection.skipped):
            lines.append(f"- and {len(collection.skipped) - len(shown)} more")
    return "\n".join(lines) + "\n"


def _groups(collection: Collection) -> Iterator[str]:
    groups = collection.groups()
    complete = [job for group in groups.values() for job in group]
    metrics = [metric for metric in MAIN if numbers(complete, metric)]
    rows = []
    for key, group in zip(told(list(groups)), groups.values(), strict=True):
        cells = []
        for metric in metrics:
            found = interval(numbers(group, metric))
            few = f" ({found.n} of {len(group)})" if found and found.n < len(group) else ""
            cells.append(f"{found}{few}" if found else "-")
        rows.append([*key, str(len(group)), *cells])
    yield from _table([*collection.varied, "n", *metrics], rows)
    yield ""
    yield "Mean ± half of its 95 % interval (Student's t) over the n seeds; (k of n) where only k have a number."
    repeats = sum(job.complete for job in collection.jobs) - len(complete)
    if repeats:
        yield ""
        yield f"Left out of the means: {repeats} with the same configuration and seed as another."


def short(collection: Collection, job: Job) -> str:
    """Name of a job: its varied overrides and its seed, or its folder if these are not unique."""
    given = {key: job.overrides[key] for key in (*collection.varied, "seed") if key in job.overrides}
    same = [other for other in collection.jobs if all(other.overrides.get(key) == given[key] for key in given)]
    return ", ".join(f"{key}={value}" for key, value in given.items()) if given and len(same) == 1 else job.name


def _error(job: Job) -> str:
    return str(job.metrics.get("error") or "no reason given")


def _line(text: str) -> str:
    return " ".join(text.split())


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """A Markdown table with columns aligned for the terminal."""
    cells = [[_line(cell).replace("|", "\\|") for cell in row] for row in (head, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for k, row in enumerate(cells):
        yield "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        if k == 0:
            yield "|" + "|".join("-" * (width + 2) for width in widths) + "|"
