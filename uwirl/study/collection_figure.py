"""Figures of a collection: box plots and learning curves; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib.figure import Figure

from uwirl.study.atomic_io import write_figure
from uwirl.study.collection import MAIN, Collection, Job, as_number, numbers, told

COLUMNS = 3
# More cannot be distinguished in a figure; 10,000 would take minutes, and more pixels than an image may have.
MOST_GROUPS = 200
# Largest number of entries in a legend.
MOST_NAMED = 24
# Length of a line in the label of a group, in characters.
WIDTH = 48


def draw(collection: Collection, folder: Path) -> list[Path]:
    """Draw boxes.png and learning_curves.png, if there is anything to show; returns the written files.

    Args:
        collection: runs to show.
        folder: created if missing.
    """
    found = {key: group for key, group in collection.groups().items() if group}
    labels = [_label(collection, key, len(found)) for key in told(list(found))]
    groups = dict(zip(labels, found.values(), strict=True))
    jobs = [job for group in groups.values() for job in group]
    figures = {}
    metrics = [metric for metric in MAIN if _spread(jobs, metric)]
    if metrics:
        figures["boxes.png"] = boxes_figure(groups, metrics)
    if any(curve(job) for job in jobs):
        figures["learning_curves.png"] = curves_figure(groups)
    for name, figure in figures.items():
        write_figure(folder / name, figure)
    return [folder / name for name in figures]


def _spread(jobs: Sequence[Job], metric: str) -> bool:
    """Whether boxes show more than the table: the metric is a number and differs between jobs."""
    truths = any(isinstance(job.metrics.get(metric), bool) for job in jobs)
    return not truths and len(set(numbers(jobs, metric))) > 1


def boxes_figure(groups: Mapping[str, Sequence[Job]], metrics: Sequence[str]) -> Figure:
    """One panel per metric, with one box and the points of each group."""
    columns = min(COLUMNS, len(metrics))
    rows = -(-len(metrics) // columns)
    lines = sum(1 + label.count("\n") for label in groups)
    height = rows * (1.2 + 0.15 * len(groups) + 0.2 * lines)
    figure = Figure(figsize=(5.0 * columns + 2.0, height), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).flatten()
    places = range(1, len(groups) + 1)
    for axes, metric in zip(panels, metrics, strict=False):
        values = [numbers(group, metric) for group in groups.values()]
        axes.boxplot(values, orientation="horizontal", positions=places, widths=0.6, showfliers=False)
        for place, value in zip(places, values, strict=True):
            axes.plot(value, [place] * len(value), ".", color="#0072B2", alpha=0.6)
        axes.set_yticks(places, list(groups), fontsize=9)
        axes.set(xlabel=metric)
        axes.locator_params(axis="x", nbins=5)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.grid(alpha=0.3, axis="x")
    panels[0].invert_yaxis()
    for axes in panels[len(metrics) :]:
        axes.set_visible(False)
    return figure


def curve(job: Job) -> list[float]:
    """Cost of each policy iteration; empty if there is none."""
    costs = job.metrics.get("cost_per_iteration")
    if not isinstance(costs, list):
        return []
    return [float("nan") if (number := as_number(x)) is None else number for x in costs]


def curves_figure(groups: Mapping[str, Sequence[Job]]) -> Figure:
    """Cost over policy iterations, one line per job, one colour per group."""
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots()
    for k, (label, group) in enumerate(groups.items()):
        curves = [values for job in group if (values := curve(job))]
        for j, values in enumerate(curves):
            axes.plot(range(1, len(values) + 1), values, color=f"C{k % 10}", lw=1.0, label=None if j else label)
    axes.set(xlabel="policy iteration", ylabel="cost of the mission")
    axes.grid(alpha=0.3)
    if len(groups) <= MOST_NAMED:
        figure.legend(fontsize=8, loc="outside right upper")
    return figure


def _label(collection: Collection, key: tuple[str, ...], groups: int) -> str:
    """Overrides of a group, broken into lines."""
    text = ", ".join(f"{name}={value}" for name, value in zip(collection.varied, key, strict=True) if value)
    # Matplotlib would interpret text between two dollar signs as a formula.
    lines = textwrap.fill(text.replace("$", r"\$"), WIDTH, break_long_words=False, break_on_hyphens=False)
    return lines or ("all" if groups == 1 else "defaults")
