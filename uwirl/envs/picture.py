"""Picture of a world from above; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from uwirl.world.scenario import Scenario

# 480 x 480 pixels.
SIZE_INCHES, DPI = (4.8, 4.8), 100


def from_above(scenario: Scenario, path: NDArray[np.floating], time: float) -> NDArray[np.uint8]:
    """Draw nodes, obstacles at their present positions, the chain, and the vehicles' paths.

    Args:
        scenario: nodes and obstacles, the same in all worlds.
        path: eta, [n, M, 4].
        time: s.

    Returns:
        [480, 480, 3].
    """
    figure = Figure(SIZE_INCHES, DPI)
    canvas, axes = FigureCanvasAgg(figure), figure.add_axes((0.14, 0.11, 0.82, 0.82))
    source, destination = scenario.source.numpy(force=True), scenario.destination.numpy(force=True)
    chain = np.concatenate([source[None, :2], path[-1, :, :2], destination[None, :2]])
    axes.plot(*chain.T, "--", color="0.5", lw=1.0)
    axes.plot(*source[:2], "s", color="tab:green", mec="k", ms=8)
    axes.plot(*destination[:2], "D", color="tab:red", mec="k", ms=8)
    present = scenario.obstacles.present.numpy(force=True)
    centre = (scenario.obstacles.centre + time * scenario.obstacles.velocity).numpy(force=True)[present]
    for place, radius in zip(centre, scenario.obstacles.radius.numpy(force=True)[present], strict=True):
        axes.add_patch(Circle(place, radius, color="tab:gray"))
    bow = 0.04 * float(np.ptp([source[:2], destination[:2]], 0).max())
    for i in range(path.shape[1]):
        x, y, _, psi = path[-1, i]
        axes.plot(path[:, i, 0], path[:, i, 1], color=f"C{i}", lw=1.5)
        axes.plot(x, y, "o", color=f"C{i}", mec="k", ms=7)
        axes.plot([x, x + bow * np.cos(psi)], [y, y + bow * np.sin(psi)], color="k", lw=1.5)
    seen = np.concatenate([chain, path[..., :2].reshape(-1, 2), centre])
    middle, half = (seen.max(0) + seen.min(0)) / 2.0, 0.56 * float(np.ptp(seen, 0).max())
    axes.set(xlim=middle[0] + np.array([-half, half]), ylim=middle[1] + np.array([-half, half]))
    axes.set(xlabel="x (m)", ylabel="y (m)", title=f"{time:.1f} s")
    axes.grid(alpha=0.3)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
