"""Figures of learning against vehicle seconds: of one run, and of many; needs matplotlib (extra `plot`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uwirl.motion.features import AXES, MotionBasis
from uwirl.motion.learning import IterationRecord
from uwirl.study import style
from uwirl.study.colours import BLUE, GREEN, ORANGE

STYLES = ("-", "--", ":", "-.")


@style.paper
def learning_figure(
    records: Sequence[IterationRecord], costs: Sequence[float | None], others: Mapping[str, float], basis: MotionBasis
) -> Figure:
    """J of the iterates, and weights of the first learner, over the vehicle time that they took.

    Args:
        records: policy iterations.
        costs: J of each iterate, None for those that were not flown again.
        others: J of other policies by their names.
        basis: gives the names of the weights.
    """
    seconds = np.array([record.seconds for record in records])
    critic = np.stack([record.critic[0].numpy(force=True) for record in records])
    actor = np.stack([record.actor[0].numpy(force=True) for record in records])
    figure = style.new(style.PAGE, 7.0)
    grid = figure.subplots(3, 2)
    cost, *panels = grid.flatten().tolist()
    _draw_costs(cost, seconds, costs, others)
    whose = " of vehicle 1" if len(records[0].critic) > 1 else ""
    _draw_weights(panels[0], seconds, critic, basis.critic_names, f"critic{whose}")
    ends = np.cumsum([len(names) for names in basis.actor_names])
    for axes, axis, names, values in zip(
        panels[1:], AXES, basis.actor_names, np.split(actor, ends[:-1], axis=1), strict=True
    ):
        _draw_weights(axes, seconds, values, names, f"actor{whose}, {axis}")
    style.letter([cost, *panels])
    return figure


def _draw_costs(axes: Axes, seconds: NDArray, costs: Sequence[float | None], others: Mapping[str, float]) -> None:
    flown = [(time, cost) for time, cost in zip(seconds, costs, strict=True) if cost is not None]
    axes.plot(*np.array(flown).T, ".-", color=BLUE, label="iterates")
    for (name, cost), colour, line in zip(others.items(), (ORANGE, GREEN, "0.5"), STYLES[1:], strict=False):
        axes.axhline(cost, color=colour, ls=line, label=name)
    known = [cost for _, cost in flown] + list(others.values())
    if max(known) > 3.0 * min(known) > 0.0:
        axes.set_yscale("log")
    axes.set(xlabel="vehicle time (s)", ylabel="$J$", title="cost of the mission")
    axes.legend()
    axes.grid()


def _draw_weights(axes: Axes, seconds: NDArray, weights: NDArray, names: Sequence[str], title: str) -> None:
    colours = style.DISTINCT
    for j, name in enumerate(names):
        style_of_line = STYLES[j // len(colours) % len(STYLES)]
        axes.plot(seconds, weights[:, j], style_of_line, lw=0.9, color=colours[j % len(colours)], label=name)
    axes.set_yscale("symlog", linthresh=1e-2)
    axes.set(xlabel="vehicle time (s)", ylabel="weight", title=title)
    axes.legend(fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, labelspacing=0.2)
    axes.grid()


def draw_band(axes: Axes, seconds: NDArray, values: NDArray, colour: str, label: str) -> None:
    """Median and range of several learners.

    Args:
        axes: where to draw.
        seconds: vehicle times, [n], s.
        values: [n, learners]; NaN before a learner's first value.
        colour: of line and band.
        label: name in the legend.
    """
    known = ~np.isnan(values).any(1)
    if not known.any():
        return
    x, y = seconds[known], values[known]
    axes.plot(x, np.median(y, 1), color=colour, label=label, drawstyle="steps-post")
    if values.shape[1] > 1:
        axes.fill_between(x, y.min(1), y.max(1), color=colour, alpha=0.2, lw=0.0, step="post")


def held_values(times: NDArray, seconds: NDArray, values: NDArray) -> NDArray:
    """What is known at each time: the newest value so far; NaN before the first.

    Args:
        times: [n], s.
        seconds: when each value became known, ascending, [k], s.
        values: [k].
    """
    place = np.searchsorted(seconds, times, side="right") - 1
    return np.where(place >= 0, values[place.clip(0)], np.nan)
