"""A mission seen from above; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from numpy.typing import NDArray

from uwirl.study.colours import GREEN, ORANGE, colours_of
from uwirl.world.scenario import Scenario


def cylinders(scenario: Scenario) -> list[tuple[tuple[float, float], float, float]]:
    """Centre at time 0, radius and influence radius of each obstacle, m."""
    obstacles = scenario.obstacles
    here = obstacles.present
    centres = [(x, y) for x, y in obstacles.centre[here].tolist()]
    return list(zip(centres, obstacles.radius[here].tolist(), obstacles.influence[here].tolist(), strict=True))


def draw_plan(axes: Axes, scenario: Scenario, eta: NDArray, arrows: int) -> None:
    """Nodes, obstacles with their radii of influence, and paths with headings.

    Args:
        axes: where to draw.
        scenario: nodes and obstacles of one world.
        eta: [n + 1, M, 4].
        arrows: number of arrows along each path, none if 0.
    """
    source, destination = scenario.source.numpy(force=True), scenario.destination.numpy(force=True)
    axes.plot([source[0], destination[0]], [source[1], destination[1]], "--", color="0.5", lw=0.7)
    for centre, radius, influence in cylinders(scenario):
        axes.add_patch(Circle(centre, radius, color="0.55", lw=0.0))
        axes.add_patch(Circle(centre, influence, color="0.55", fill=False, ls=":"))
    for (x, y, _, psi), colour in zip(eta.transpose(1, 2, 0), colours_of(eta.shape[1]), strict=True):
        axes.plot(x, y, color=colour)
        # Vehicles rest for much of a mission, so arrows are spread over the path, not over the time.
        along = np.concatenate([[0.0], np.hypot(np.diff(x), np.diff(y)).cumsum()])
        some = np.searchsorted(along, np.linspace(0.0, along[-1], arrows + 1)[:-1])
        axes.quiver(x[some], y[some], np.cos(psi[some]), np.sin(psi[some]), width=0.006, scale=16, zorder=3)
        axes.plot(x[0], y[0], "o", color=colour, mfc="white", zorder=3)
        axes.plot(x[-1], y[-1], "o", color=colour, zorder=3)
    axes.plot(*source[:2], "s", color=GREEN, zorder=3)
    axes.plot(*destination[:2], "D", color=ORANGE, zorder=3)
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)", aspect="equal")
    axes.grid()
