"""Animation of a mission from above, as a GIF; needs matplotlib (extra `plot`), which brings Pillow."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray
from PIL import Image

from uwirl.study.atomic_io import write_whole
from uwirl.study.colours import GREEN, ORANGE, colours_of
from uwirl.study.evaluation import Evaluation
from uwirl.world.scenario import Scenario

# 680 x 850 pixels.
SIZE_INCHES, DPI = (6.8, 8.5), 100
# Bow and two corners of the stern (ahead, to port), as fractions of the map's width.
TRIANGLE = np.array([[0.026, 0.0], [-0.017, 0.016], [-0.017, -0.016]])


def save(
    scenario: Scenario, evaluation: Evaluation, path: Path, world: int = 0, fps: int = 10, speed: float = 8.0
) -> None:
    """Write a mission of one world: the chain from above, and under it the worst link's capacity (5) over time.

    Links are coloured by their mean capacity; dotted rings are the obstacles' radii of influence rho_o.

    Args:
        scenario: nodes and obstacles of all worlds.
        evaluation: the mission.
        path: path of the GIF; its folder is created if missing.
        world: number of the world in the batch.
        fps: frames per second.
        speed: seconds of the mission per second of the animation.

    Raises:
        ValueError: `fps` or `speed` is not positive.
    """
    if fps <= 0 or speed <= 0.0:
        raise ValueError(f"fps and speed must be greater than 0, got {fps} and {speed}")
    film = _Film(scenario, evaluation, world)
    frames = max(2, round(evaluation.trajectory.dt * (len(film.time) - 1) / speed * fps))
    images = [film.frame(k) for k in np.linspace(0, len(film.time) - 1, frames).round().astype(int)]
    # With the colour bar, the palette of the first frame contains all colours of the links.
    palette = images[0].quantize(method=Image.Quantize.FASTOCTREE)
    first, *others = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images)
    path.parent.mkdir(parents=True, exist_ok=True)
    film_bytes = io.BytesIO()
    first.save(film_bytes, "GIF", save_all=True, append_images=others, duration=round(1000 / fps), loop=0)
    write_whole(path, film_bytes.getvalue())


def _cylinders(scenario: Scenario, world: int, time: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Centres [n + 1, O, 2] at times [n + 1] in s, radii rho_m and rho_o [O] of a world's obstacles, m."""
    obstacles = scenario.obstacles.worlds(torch.tensor([world], device=scenario.source.device))
    present = obstacles.present.flatten()
    place, velocity = (f.view(-1, 2)[present].numpy(force=True) for f in (obstacles.centre, obstacles.velocity))
    radius, influence = (f.flatten()[present].numpy(force=True) for f in (obstacles.radius, obstacles.influence))
    return place + velocity * time[:, None, None], radius, influence


class _Film:
    """A background that is drawn once, and moving artists."""

    def __init__(self, scenario: Scenario, evaluation: Evaluation, world: int):
        self.time = evaluation.trajectory.time.numpy(force=True)
        self.eta = evaluation.trajectory.eta[:, world].numpy(force=True)
        ends = torch.stack([scenario.source, scenario.destination])[:, None, None, :2].numpy(force=True)
        source, destination = np.broadcast_to(ends, (2, len(self.time), 1, 2))
        self.chain = np.concatenate([source, self.eta[..., :2], destination], 1)
        self.capacity = evaluation.link_capacity[:, world].numpy(force=True)
        self.worst, self.optimum = self.capacity.min(1), evaluation.optimal_capacity
        self.centre, radius, influence = _cylinders(scenario, world, self.time)

        self.figure = Figure(SIZE_INCHES, DPI)
        self.canvas = FigureCanvasAgg(self.figure)
        self.clock = self.figure.text(0.49, 0.93, "", ha="center", family="monospace", size=11)
        self._map(self.figure.add_axes((0.11, 0.31, 0.76, 0.608)), radius, influence)
        self._curve(self.figure.add_axes((0.11, 0.07, 0.76, 0.16)))
        # In drawing order, from the lowest layer to the highest.
        self.moving: list[Artist] = [*self.rings, self.links, *self.cylinders, *self.trails, *self.nodes, *self.hulls]
        self.moving += [self.marker, self.clock]
        for artist in self.moving:
            artist.set_animated(True)
        self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(self.figure.bbox)

    def _map(self, axes: Axes, radius: NDArray, influence: NDArray) -> None:
        corners = (self.centre[0] + sign * radius[:, None] for sign in (-1.0, 1.0))
        seen = np.concatenate([self.chain.reshape(-1, 2), *corners])
        middle, self.width = (seen.max(0) + seen.min(0)) / 2.0, 1.12 * float(np.ptp(seen, 0).max())
        (left, bottom), (right, top) = middle - self.width / 2.0, middle + self.width / 2.0
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="x (m)", ylabel="y (m)")
        axes.grid(alpha=0.3)
        self.links = LineCollection([], cmap="viridis", norm=Normalize(0.0, 1.25 * self.optimum), lw=3.0)
        axes.add_collection(self.links)
        scale = self.figure.add_axes((0.89, 0.31, 0.025, 0.608))
        self.figure.colorbar(self.links, cax=scale, extend="max", label="mean capacity of a link (kbit/s)")
        self.cylinders = [Circle((0.0, 0.0), r, color="tab:gray") for r in radius]
        self.rings = [Circle((0.0, 0.0), r, ec="tab:gray", fill=False, ls=":") for r in influence]
        vehicles = range(self.eta.shape[1])
        colours = colours_of(self.eta.shape[1])
        self.hulls = [Polygon(TRIANGLE, fc=colours[i], ec="k", lw=0.8, label=f"vehicle {i + 1}") for i in vehicles]
        for patch in (*self.cylinders, *self.rings, *self.hulls):
            axes.add_patch(patch)
        self.trails = [axes.plot([], [], color=colours[i], lw=1.2)[0] for i in vehicles]
        self.nodes = [
            *axes.plot(*self.chain[0, 0], "s", color=GREEN, mec="k", ms=8, label="source"),
            *axes.plot(*self.chain[0, -1], "D", color=ORANGE, mec="k", ms=8, label="destination"),
        ]
        handles = [*self.nodes, *self.hulls]
        self.figure.legend(handles=handles, loc="upper center", ncols=5, fontsize=9, frameon=False, handlelength=1.2)

    def _curve(self, axes: Axes) -> None:
        axes.plot(self.time, self.worst, color="0.35", lw=1.4)
        axes.axhline(self.optimum, color="0.6", ls="--", lw=1.0, label="optimum")
        (self.marker,) = axes.plot([], [], "o", color="k", ms=7, clip_on=False)
        axes.set(xlabel="t (s)", ylabel="worst link (kbit/s)", xlim=(self.time[0], self.time[-1]))
        axes.set_ylim(0.0, 1.15 * max(self.optimum, float(self.worst.max())))
        axes.legend(loc="lower right", fontsize=9)
        axes.grid(alpha=0.3)

    def frame(self, k: int) -> Image.Image:
        """The picture at step k."""
        self.clock.set_text(f"t = {self.time[k]:5.1f} s    chain {self.worst[k]:5.1f} of {self.optimum:.1f} kbit/s")
        self.links.set_segments(list(np.stack([self.chain[k, :-1], self.chain[k, 1:]], 1)))
        self.links.set_array(self.capacity[k])
        for circle, ring, centre in zip(self.cylinders, self.rings, self.centre[k], strict=True):
            circle.set_center(centre)
            ring.set_center(centre)
        for trail, hull, flown in zip(self.trails, self.hulls, self.eta[: k + 1].swapaxes(0, 1), strict=True):
            trail.set_data(flown[:, 0], flown[:, 1])
            c, s = np.cos(flown[-1, 3]), np.sin(flown[-1, 3])
            hull.set_xy(flown[-1, :2] + self.width * TRIANGLE @ np.array([[c, s], [-s, c]]))
        self.marker.set_data([self.time[k]], [self.worst[k]])
        self.canvas.restore_region(self.background)
        for artist in self.moving:
            self.figure.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())).convert("RGB")
