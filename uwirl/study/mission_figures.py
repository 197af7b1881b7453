"""Figures of a mission (Fig. 5 of the paper): paths and capacities, pose and control; needs matplotlib."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from uwirl.study import style
from uwirl.study.colours import GREEN, ORANGE, colours_of
from uwirl.study.evaluation import Evaluation
from uwirl.study.plan_view import cylinders, draw_plan
from uwirl.study.shadowing import LinksAtMessages
from uwirl.world.scenario import Scenario

# Number of arrows of heading along the paths.
ARROWS = 8
# More links are told apart by no line style.
MOST_LINKS = 4
LINK_STYLES = ("-", "--", ":", "-.")
# Least height of the box of the 3-D path, as a share of its longest side: flatter ones are stretched.
LEAST_HEIGHT = 0.12
MOTION = (
    ("$x$ (m)", "$y$ (m)", "$z$ (m)", "heading $\\psi$ (rad)"),
    ("surge force $X$ (N)", "sway force $Y$ (N)", "heave force $Z$ (N)", "yaw moment $N$ (N m)"),
)


@style.paper
def mission_figure(scenario: Scenario, evaluation: Evaluation, messages: LinksAtMessages) -> Figure:
    """Paths in 3-D and from above, and capacities of the links over time.

    Args:
        scenario: the nodes.
        evaluation: the mission; its first world is drawn.
        messages: link capacities with shadowing.
    """
    eta = evaluation.trajectory.eta[:, 0].numpy(force=True)
    figure = style.new(style.PAGE, 5.2)
    # The layout does not see labels of 3-D axes.
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 0.62), width_ratios=(1.05, 0.08, 1.0))
    space = figure.add_subplot(grid[0, 0], projection="3d")
    plan, capacity = figure.add_subplot(grid[0, 2]), figure.add_subplot(grid[1, :])
    _draw_space(space, scenario, eta)
    draw_plan(plan, scenario, eta, arrows=max(2, ARROWS // eta.shape[1]))
    plan.set_title("from above, from $\\circ$ to $\\bullet$, with heading")
    _draw_capacities(capacity, evaluation, messages)
    style.letter([space, plan, capacity])
    return figure


@style.paper
def motion_figure(evaluation: Evaluation, tau_max: Tensor) -> Figure:
    """Pose and control of each vehicle over time.

    Args:
        evaluation: the mission; its first world is drawn.
        tau_max: thruster limits, [4], N and N m.
    """
    trajectory = evaluation.trajectory
    time = trajectory.time.numpy(force=True)
    eta, tau = trajectory.eta[:, 0].numpy(force=True), trajectory.tau[:, 0].numpy(force=True)
    colours = colours_of(eta.shape[1])
    figure = style.new(style.PAGE, 5.6)
    panels = figure.subplots(4, 2, sharex=True)
    for column, (values, labels) in enumerate(zip((eta, tau), MOTION, strict=True)):
        for k, (axes, label) in enumerate(zip(panels[:, column], labels, strict=True)):
            for i, colour in enumerate(colours):
                axes.plot(time[: len(values)], values[:, i, k], color=colour, label=_name(i, len(colours)))
            axes.set(ylabel=label)
            axes.grid()
    for axes, limit in zip(panels[:, 1], tau_max.tolist(), strict=True):
        # Axes follow the control, and show limits that it comes close to.
        axes.set_ylim(*axes.get_ylim())
        for sign in (-1.0, 1.0):
            axes.axhline(sign * limit, color="0.4", ls=":")
    panels[0, 0].set_title("pose")
    panels[0, 1].set_title("control (dotted: thruster limits)")
    for axes in panels[-1]:
        axes.set_xlabel("$t$ (s)")
    style.letter(list(panels[0]))
    if len(colours) > 1:
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6, frameon=False)
    return figure


def _name(i: int, vehicles: int) -> str | None:
    """Label of vehicle i of M in a legend; of a long chain only the first and the last have one."""
    return f"vehicle {i + 1}" if vehicles <= 6 or i in (0, vehicles - 1) else None


def _draw_space(axes: Axes, scenario: Scenario, eta: NDArray) -> None:
    nodes = np.stack([scenario.source.numpy(force=True), scenario.destination.numpy(force=True)])
    axes.plot(*nodes.T, "--", color="0.5", lw=0.7)
    axes.plot(*nodes[:1].T, "s", color=GREEN, label="source")
    axes.plot(*nodes[1:].T, "D", color=ORANGE, label="destination")
    colours = colours_of(eta.shape[1])
    for i, colour in enumerate(colours):
        axes.plot(*eta[:, i, :3].T, color=colour, label=_name(i, len(colours)))
        axes.plot(*eta[:1, i, :3].T, "o", color=colour, mfc="white")
        axes.plot(*eta[-1:, i, :3].T, "o", color=colour)
    seen = np.concatenate([eta[..., :3].reshape(-1, 3), nodes])
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24), [seen[:, 2].min(), seen[:, 2].max()])
    for (x, y), radius, _ in cylinders(scenario):
        ring = (x + radius * np.cos(angle), y + radius * np.sin(angle))
        axes.plot_surface(*ring, height, color="0.55", alpha=0.5, lw=0.0)  # type: ignore[attr-defined]
        seen = np.concatenate([seen, np.stack([*ring, height], -1).reshape(-1, 3)])
    low, high = seen.min(0), seen.max(0)
    size = high - low
    longest = float(size.max())
    box = np.maximum(size, LEAST_HEIGHT * longest)
    # Sides that are stretched are given the room that they are shown with.
    flat = size < 1e-3 * longest
    low, high = np.where(flat, (low + high - box) / 2.0, low), np.where(flat, (low + high + box) / 2.0, high)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    # Matplotlib changes the array that it is given.
    axes.set_box_aspect(box.copy(), zoom=0.87)  # type: ignore[call-arg]
    stretch = np.where(flat, 1.0, box / size.clip(1e-9))
    names = (f"${name}$ (m{f', {by:.1f} times' if by > 1.05 else ''})" for name, by in zip("xyz", stretch, strict=True))
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), names, strict=True):  # type: ignore[attr-defined]
        axis.set_label_text(name)
        axis.set_tick_params(pad=-2)
        axis.labelpad = -4
    for axis, side in zip("xyz", box, strict=True):
        axes.locator_params(axis, nbins=max(2, round(5.0 * float(side / box.max()))))  # type: ignore[arg-type]
    axes.set_title("path" if stretch.max() > 1.05 else "path, true to scale", loc="left")
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, columnspacing=1.0)


def _draw_capacities(axes: Axes, evaluation: Evaluation, messages: LinksAtMessages) -> None:
    time = evaluation.trajectory.time.numpy(force=True)
    links = evaluation.link_capacity[:, 0].numpy(force=True)
    last = links.shape[1] - 1
    for j in range(last + 1):
        ends = "source" if j == 0 else f"{j}", "destination" if j == last else f"{j + 1}"
        few = last < MOST_LINKS
        label = f"{ends[0]} to {ends[1]}" if few else None if j else "links"
        axes.plot(time, links[:, j], LINK_STYLES[j if few else 0], color="0.5", lw=0.8, label=label)
    axes.plot(time, evaluation.chain_capacity[:, 0].numpy(force=True), "k", lw=1.4, label="chain")
    shadowed = messages.link_capacity.amin(-1).numpy(force=True)
    axes.plot(messages.time.numpy(force=True), shadowed, ".", color=ORANGE, ms=2.5, label="chain with shadowing")
    axes.axhline(0.99 * evaluation.optimal_capacity, color=GREEN, ls=":", label="99 % of the optimum")
    t99 = evaluation.time_to_99_percent()
    if t99 is not None:
        axes.axvline(t99, color=GREEN, lw=0.7, label=f"reached after {t99:.1f} s")
    axes.set(xlabel="$t$ (s)", ylabel="capacity (kbit/s)", title="mean capacity of the links", xlim=(0.0, time[-1]))
    # Next to a node, capacity has no bound.
    axes.set_ylim(top=min(axes.get_ylim()[1], 3.5 * evaluation.optimal_capacity))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes.grid()
