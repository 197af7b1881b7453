"""What a map of the shadowing is worth: true capacity where it says, at the midpoint, and where it is best.

    python experiments/planning_on_map.py

For each seed: the vehicle's readings and those of source and destination, maximum likelihood, kriging, and the place
whose worse link the map expects to be best. The figure shows what that place truly carries, path loss and shadowing,
beside the midpoint, which is all that path loss can tell.

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import hydra
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave, tell
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.motion.shadowed_targets import shadowed_targets
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimators import estimate_each_vehicle
from uwirl.snr.intervals import student_t
from uwirl.snr.kriging import Kriging
from uwirl.study import shadowing, style
from uwirl.study.colours import GREEN, ORANGE
from uwirl.study.progress import bar
from uwirl.world.truth import truth_of

log = logging.getLogger("uwirl")


class Example(NamedTuple):
    """One seed's horizontal map of relay capacity at the nodes' depth, and the places on it.

    Attributes:
        axes: x [X] and y [Y], m.
        truth, expected: capacity, [X, Y], kbit/s.
        places: midpoint, where the map says, where it is best; [3, 3], m.
        sensors: [N, 3], m.
        nodes: source and destination, [2, 3], m.
    """

    axes: tuple[Tensor, Tensor]
    truth: Tensor
    expected: Tensor
    places: Tensor
    sensors: Tensor
    nodes: Tensor


def one_seed(overrides: list[str], seed: int) -> tuple[list[float], Example]:
    """True capacity at the midpoint, where the map says and at best, kbit/s, and the maps."""
    config = compose([*overrides, f"seed={seed}"])
    validate(config)
    env = build.make_relay(config)
    assert env.scenario.vehicles == 1, "one relay"
    readings, estimate = estimate_each_vehicle(env, build.make_estimator(config.estimator, env))
    kriging = Kriging(readings[0], estimate.channel)
    targets = mean_channel_targets(env.scenario, estimate.channel)
    truth = truth_of(env)
    best = shadowed_targets(env.scenario, truth.snr_dB, targets.frame.target)
    places = torch.cat([targets.frame.target.double(), shadowing.map_targets(env, kriging, targets).double(), best])
    capacity = truth.link_capacities_kbps(places[:, None, None], shadowed=True)[:, 0].amin(-1)
    axes = shadowing.map_grid(env, 1.0)
    plane = torch.nn.functional.pad(torch.cartesian_prod(*axes), (0, 1), value=float(places[0, 2]))
    carried = truth.link_capacities_kbps(plane[:, None, None], shadowed=True)[:, 0].amin(-1)
    nodes = torch.stack([env.scenario.source, env.scenario.destination]).double()
    expected = kriging.relay(nodes[0], nodes[1], plane)
    shape = len(axes[0]), len(axes[1])
    example = Example(axes, carried.view(shape), expected.view(shape), places, env.scenario.sensors, nodes)
    return capacity.tolist(), example


def statistics(capacity: Tensor) -> dict[str, float]:
    """Of gains over the midpoint, [seeds, 3] in kbit/s."""
    seeds = len(capacity)
    t = student_t(0.95, seeds - 1)
    metrics: dict[str, float] = {}
    for k, name in ((1, "map"), (2, "best")):
        gain = 100.0 * (capacity[:, k] / capacity[:, 0] - 1.0)
        metrics |= {
            f"gain_{name}_percent": float(gain.mean()),
            f"gain_{name}_percent_half_interval_95": t * float(gain.std()) / seeds**0.5,
            f"worse_{name}_percent": 100.0 * float((gain < 0.0).double().mean()),
        }
    metrics |= {f"capacity_{n}_kbps": float(capacity[:, k].mean()) for k, n in enumerate(("midpoint", "map", "best"))}
    return metrics


@style.paper
def draw(capacity: Tensor, example: Example) -> Figure:
    """Maps of one seed, and what each seed's places carry."""
    figure = style.new(style.PAGE, 5.6)
    grid = figure.add_gridspec(2, 2)
    left, middle = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    right = figure.add_subplot(grid[1, :])
    top = float(example.truth.quantile(0.995))
    for axes, values, title in ((left, example.truth, "(a) true"), (middle, example.expected, "(b) kriged")):
        filled = axes.pcolormesh(*example.axes, values.T, vmin=0.0, vmax=top, cmap="cividis", shading="nearest")
        mark(axes, example)
        axes.set_title(f"{title} capacity of a relay, seed 0")
    figure.colorbar(filled, ax=[left, middle], label="worse link at the nodes' depth (kbit/s)")
    middle.legend(loc="upper left")
    right.plot([0.0, 1.05 * float(capacity.max())], [0.0, 1.05 * float(capacity.max())], color="0.6", lw=1.0)
    right.plot(capacity[:, 0], capacity[:, 2], "^", color=GREEN, mfc="none", label="where it is best")
    right.plot(capacity[:, 0], capacity[:, 1], "o", color=ORANGE, label="where the map says")
    low = 0.9 * float(capacity.min())
    limits = (low, 1.03 * float(capacity.max()))
    right.set(xlim=limits, ylim=limits, aspect="equal", ylabel="true capacity there (kbit/s)")
    right.set_xlabel("true capacity at the midpoint (kbit/s)")
    right.set_title(f"(c) {len(capacity)} seeds")
    right.legend(loc="lower right")
    right.grid()
    return figure


def mark(axes: Axes, example: Example) -> None:
    """Nodes, sensors and places on a map."""
    axes.plot(*example.sensors[:, :2].T, ".", color="white", ms=1.5, alpha=0.7)
    axes.plot(*example.nodes[:, :2].T, "s", color="white", mec="black", mew=0.5, ms=5)
    styles = (("D", "white", "midpoint"), ("o", ORANGE, "where the map says"), ("^", GREEN, "where it is best"))
    for place, (marker, colour, name) in zip(example.places.tolist(), styles, strict=True):
        axes.plot(*place[:2], marker, color=colour, mec="black", mew=0.5, ms=5, ls="none", label=name)
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")


@hydra.main(version_base="1.3", config_path="conf", config_name="planning_on_map")
@torch.no_grad()
def main(settings: DictConfig) -> None:
    """Run all seeds, draw, and write metrics.json."""
    torch.set_num_threads(1)
    rows, examples = [], []
    with bar("mapping", settings.seeds) as progress:
        for seed in range(settings.seeds):
            row, example = one_seed(list(settings.overrides), seed)
            rows.append(row)
            examples.append(example)
            log.info("seed %2d: midpoint %.3f, map %.3f, best %.3f kbit/s", seed, *row)
            progress.update()
    capacity = torch.tensor(rows, dtype=torch.float64)
    metrics = statistics(capacity)
    tell(metrics, ".3f")
    leave(metrics, draw(capacity, examples[0]))


if __name__ == "__main__":
    main()
