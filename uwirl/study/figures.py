"""Figures of a run; needs matplotlib (extra `plot`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uwirl.motion.features import AXES, MotionBasis
from uwirl.motion.learning import IterationRecord
from uwirl.study.atomic_io import write_figure
from uwirl.study.evaluation import Evaluation
from uwirl.study.shadowing import LinksAtMessages
from uwirl.world.layouts import KINDS
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario

POSE_LABELS = ("x (m)", "y (m)", "z (m)", "psi (rad)")
STYLES = ("-", "--", ":", "-.")
CONTROL_LABELS = ("surge (N)", "sway (N)", "heave (N)", "yaw (N m)")


def mission_figure(
    scenario: Scenario,
    evaluation: Evaluation,
    messages: LinksAtMessages,
    records: Sequence[IterationRecord],
    basis: MotionBasis | None,
) -> Figure:
    """Fig. 5's panels: path in 3-D and from above, pose, control, weights over iterations, link capacities.

    Args:
        scenario: the nodes.
        evaluation: the mission; its first world is drawn.
        messages: link capacities with shadowing.
        records: policy iterations; empty for planners that do not learn.
        basis: gives the names of the weights; None without records.
    """
    trajectory = evaluation.trajectory
    time = trajectory.time.numpy(force=True)
    eta, tau = trajectory.eta[:, 0].numpy(force=True), trajectory.tau[:, 0].numpy(force=True)
    figure = plt.figure(figsize=(16.0, 11.5), layout="constrained")
    panels = figure.add_gridspec(3, 3)
    _path_3d(figure.add_subplot(panels[0, 0], projection="3d"), scenario, eta)
    _path_top(figure.add_subplot(panels[0, 1]), scenario, eta)
    _capacities(figure.add_subplot(panels[0, 2]), time, evaluation, messages)
    _series(figure.add_subplot(panels[1, 0]), time, eta[..., :3], POSE_LABELS[:3], "(b) position", "m")
    _series(figure.add_subplot(panels[1, 1]), time, eta[..., 3:], POSE_LABELS[3:], "(b) orientation", "rad")
    _series(figure.add_subplot(panels[1, 2]), time[:-1], tau, CONTROL_LABELS, "(c) control", "N, N m")
    if records and basis is not None:
        seconds = np.array([record.seconds for record in records])
        critic = np.stack([record.critic[0].numpy(force=True) for record in records])
        actor = np.stack([record.actor[0].numpy(force=True) for record in records])
        _weights(figure.add_subplot(panels[2, 0]), seconds, critic, basis.critic_names, "(d) critic weights")
        sizes = [len(names) for names in basis.actor_names]
        planar, rest = sum(sizes[:2]), sum(sizes)
        names = [f"{axis}: {name}" for axis, group in zip(AXES, basis.actor_names, strict=True) for name in group]
        _weights(
            figure.add_subplot(panels[2, 1]), seconds, actor[:, :planar], names[:planar], "(e) actor, surge and sway"
        )
        _weights(
            figure.add_subplot(panels[2, 2]), seconds, actor[:, planar:rest], names[planar:], "(e) actor, heave and yaw"
        )
    return figure


def layouts_figure(env: Relay, evaluation: Evaluation, kind: Tensor) -> Figure:
    """Missions in random layouts from above, four of each kind.

    Args:
        env: the worlds flown.
        evaluation: evaluation of these worlds.
        kind: kind of each world, index into KINDS.
    """
    kind = kind[: env.worlds]
    kinds = kind.unique().tolist()
    figure, grid = plt.subplots(
        len(kinds), 4, figsize=(12.0, 3.0 * len(kinds)), layout="constrained", squeeze=False, sharex=True, sharey=True
    )
    for row, k in zip(grid, kinds, strict=True):
        for axes, world in zip(row, (kind == k).nonzero()[:, 0].tolist(), strict=False):
            scenario = env.scenario.worlds(torch.tensor([world]))
            scenario = replace(scenario, obstacles=scenario.obstacles.each(lambda field: field[0]))
            _path_top(axes, scenario, evaluation.trajectory.eta[:, world].numpy(force=True), arrows=False)
            t99 = evaluation.time_to_99_percent(world)
            fate = (
                "blocked" if bool(evaluation.blocked[world].any()) else "not reached" if t99 is None else f"{t99:.0f} s"
            )
            axes.set(title=f"{KINDS[k]}: {fate}", xlim=(-40, 40), ylim=(-40, 40))
            axes.label_outer()
    return figure


def gap_figure(gaps: Mapping[str, Tensor]) -> Figure:
    """Gap of J to the optimiser, in %: one point per layout for each planner, and the median."""
    figure, axes = plt.subplots(figsize=(8.0, 0.7 * len(gaps) + 1.5), layout="constrained")
    for row, gap in enumerate(gaps.values()):
        spread = np.linspace(-0.25, 0.25, len(gap))
        axes.plot(gap.clamp_min(0.1).numpy(force=True), row + spread, ".", color=f"C{row}", ms=5)
        median = float(gap.median())
        axes.plot([median, median], [row - 0.35, row + 0.35], "k", lw=2)
        axes.annotate(f"{median:.1f} %", (median, row - 0.37), ha="center", va="bottom", fontsize=8)
    axes.set_yticks(range(len(gaps)), list(gaps))
    axes.set(xscale="log", xlabel="J above the trajectory optimiser's (%)")
    axes.invert_yaxis()
    axes.grid(alpha=0.3, axis="x", which="both")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write and close a figure."""
    write_figure(path, figure)
    plt.close(figure)


def _path_3d(axes: Axes, scenario: Scenario, eta: NDArray) -> None:
    nodes = np.stack([scenario.source.numpy(force=True), scenario.destination.numpy(force=True)])
    axes.plot(*nodes.T, "k--", lw=0.8)
    axes.plot(*nodes[:1].T, "s", color="tab:green", label="source")
    axes.plot(*nodes[1:].T, "D", color="tab:red", label="destination")
    for i in range(eta.shape[1]):
        axes.plot(*eta[:, i, :3].T, color=f"C{i}", label=f"vehicle {i + 1}")
        axes.plot(*eta[:1, i, :3].T, "o", color=f"C{i}", mfc="none")
        axes.plot(*eta[-1:, i, :3].T, "o", color=f"C{i}")
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24), [min(eta[..., 2].min(), *nodes[:, 2]), 0.0])
    for (x, y), radius, _ in _cylinders(scenario):
        axes.plot_surface(  # type: ignore[attr-defined]
            x + radius * np.cos(angle), y + radius * np.sin(angle), height, color="tab:gray", alpha=0.4
        )
    axes.set(xlabel="x (m)", ylabel="y (m)", title="(a) path")
    axes.set_zlabel("z (m)")  # type: ignore[attr-defined]
    axes.legend(fontsize=8)


def _path_top(axes: Axes, scenario: Scenario, eta: NDArray, arrows: bool = True) -> None:
    source, destination = scenario.source.numpy(force=True), scenario.destination.numpy(force=True)
    axes.plot([source[0], destination[0]], [source[1], destination[1]], "k--", lw=0.8)
    axes.plot(*source[:2], "s", color="tab:green")
    axes.plot(*destination[:2], "D", color="tab:red")
    for i in range(eta.shape[1]):
        x, y, psi = eta[:, i, 0], eta[:, i, 1], eta[:, i, 3]
        axes.plot(x, y, color=f"C{i}")
        some = np.linspace(0, len(x) // 2, 9 if arrows else 0).astype(int)
        axes.quiver(x[some], y[some], np.cos(psi[some]), np.sin(psi[some]), width=0.006, scale=16, zorder=3)
        axes.plot(x[0], y[0], "o", color=f"C{i}", mfc="none")
        axes.plot(x[-1], y[-1], "o", color=f"C{i}")
    for centre, radius, influence in _cylinders(scenario):
        axes.add_patch(plt.Circle(centre, radius, color="tab:gray"))
        axes.add_patch(plt.Circle(centre, influence, color="tab:gray", fill=False, ls=":"))
    axes.set(xlabel="x (m)", ylabel="y (m)", title="(a) path from above, heading as arrows", aspect="equal")
    axes.grid(alpha=0.3)


def _cylinders(scenario: Scenario) -> list[tuple[tuple[float, float], float, float]]:
    """Centre at time 0, radius and influence radius of each obstacle, m."""
    obstacles = scenario.obstacles
    here = obstacles.present
    centres = [(x, y) for x, y in obstacles.centre[here].tolist()]
    return list(zip(centres, obstacles.radius[here].tolist(), obstacles.influence[here].tolist(), strict=True))


def _capacities(axes: Axes, time: NDArray, evaluation: Evaluation, messages: LinksAtMessages) -> None:
    links = evaluation.link_capacity[:, 0].numpy(force=True)
    shown = np.clip(links, None, 3.0 * evaluation.optimal_capacity)
    for j in range(links.shape[1]):
        axes.plot(time, shown[:, j], lw=1.0, label=f"link {j} to {j + 1}")
    axes.plot(time, evaluation.chain_capacity[:, 0].numpy(force=True), "k", lw=1.8, label="chain")
    shadowed = messages.link_capacity.amin(-1).numpy(force=True)
    axes.plot(
        messages.time.numpy(force=True), shadowed, ".", color="tab:red", ms=3, label="chain, shadowed, at messages"
    )
    axes.axhline(0.99 * evaluation.optimal_capacity, color="gray", ls=":", label="99 % of the optimum")
    t99 = evaluation.time_to_99_percent()
    if t99 is not None:
        axes.axvline(t99, color="gray", lw=0.8)
    axes.set(xlabel="t (s)", ylabel="capacity (kbit/s)", title="(f) link capacity of path loss")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _series(axes: Axes, time: NDArray, values: NDArray, labels: Sequence[str], title: str, unit: str) -> None:
    """Plot values [n, M, k]: one colour for each of the k, one line style for each vehicle."""
    for j, label in enumerate(labels):
        for i in range(values.shape[1]):
            axes.plot(time, values[:, i, j], label=None if i else label, color=f"C{j}", ls=STYLES[i % 4], lw=1.1)
    if values.shape[1] > 1:
        title += ": " + ", ".join(f"vehicle {i + 1} {style}" for i, style in enumerate(STYLES[: values.shape[1]]))
    axes.set(xlabel="t (s)", ylabel=unit, title=title)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)


def _weights(axes: Axes, seconds: NDArray, weights: NDArray, names: Sequence[str], title: str) -> None:
    for j, name in enumerate(names):
        axes.plot(seconds, weights[:, j], label=name, lw=1.0, color=plt.cm.tab20(j % 20))
    axes.set_yscale("symlog", linthresh=1e-2)
    axes.set(xlabel="vehicle time (s)", ylabel="weight", title=title)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes.grid(alpha=0.3)
