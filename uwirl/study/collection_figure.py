"""Figures of a collection: box plots and learning curves; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uwirl.study import style
from uwirl.study.collection import MAIN, Collection, Job, numbers, told
from uwirl.study.colours import BLUE, colours_of
from uwirl.study.learning_figure import draw_band, held_values

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
    if any(job.learned for job in jobs):
        figures["learning_curves.png"] = curves_figure(groups)
    for name, figure in figures.items():
        style.save(figure, folder / name)
    return [folder / name for name in figures]


def _spread(jobs: Sequence[Job], metric: str) -> bool:
    """Whether boxes show more than the table: the metric is a number and differs between jobs."""
    truths = any(isinstance(job.metrics.get(metric), bool) for job in jobs)
    return not truths and len(set(numbers(jobs, metric))) > 1


@style.paper
def boxes_figure(groups: Mapping[str, Sequence[Job]], metrics: Sequence[str]) -> Figure:
    """One panel per metric, with one box and the points of each group."""
    columns = min(COLUMNS, len(metrics))
    rows = -(-len(metrics) // columns)
    lines = sum(1 + label.count("\n") for label in groups)
    figure = style.new(style.PAGE, rows * (0.6 + 0.08 * len(groups) + 0.13 * lines))
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).flatten()
    places = range(1, len(groups) + 1)
    for axes, metric in zip(panels, metrics, strict=False):
        values = [numbers(group, metric) for group in groups.values()]
        axes.boxplot(values, orientation="horizontal", positions=places, widths=0.6, showfliers=False)
        for place, value in zip(places, values, strict=True):
            axes.plot(value, [place] * len(value), ".", color=BLUE, alpha=0.6)
        axes.set_yticks(places, list(groups))
        axes.set(xlabel=metric)
        axes.locator_params(axis="x", nbins=4)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.grid(axis="x")
    panels[0].invert_yaxis()
    for axes in panels[len(metrics) :]:
        axes.set_visible(False)
    return figure


@style.paper
def curves_figure(groups: Mapping[str, Sequence[Job]]) -> Figure:
    """J against vehicle seconds: of each group, the median of what its jobs knew at that time, and their range."""
    named = len(groups) <= MOST_NAMED
    figure = style.new(style.PAGE if named and len(groups) > 1 else style.COLUMN, 2.8)
    axes = figure.subplots()
    for (label, group), colour in zip(groups.items(), colours_of(len(groups)), strict=True):
        curves = [np.array(job.learned).T for job in group if job.learned]
        if curves:
            times = np.unique(np.concatenate([seconds for seconds, _ in curves]))
            known = np.stack([held_values(times, *curve) for curve in curves], -1)
            draw_band(axes, times, known, colour, f"{label} ({len(curves)})")
    axes.set(xlabel="vehicle time (s)", ylabel="$J$ of the mission", title="median and range over runs")
    axes.grid()
    if named:
        figure.legend(loc="outside right upper", frameon=False)
    return figure


def _label(collection: Collection, key: tuple[str, ...], groups: int) -> str:
    """Overrides of a group, broken into lines."""
    text = ", ".join(f"{name}={value}" for name, value in zip(collection.varied, key, strict=True) if value)
    # Matplotlib would interpret text between two dollar signs as a formula.
    lines = textwrap.fill(text.replace("$", r"\$"), WIDTH, break_long_words=False, break_on_hyphens=False)
    return lines or ("all" if groups == 1 else "defaults")
