"""How much of the optimal cost is lost after so many seconds of flight, over twelve starts and several seeds.

    python experiments/learning_curve.py

The gap is sum J / sum J_reference - 1 over the starts (a mean of ratios would be three times larger, because starts
near the target cost almost nothing). The reference costs are those of a direct trajectory optimiser (implicit
trapezoid, 200 intervals, 80 s) on the same cost in free water.

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

import logging

import hydra
import torch
from learned import learn
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.study import style
from uwirl.study.colours import BLUE, ORANGE
from uwirl.study.evaluation import Evaluator
from uwirl.world.random import RandomStreams

log = logging.getLogger("uwirl")

# x, y, z, psi and the reference J; the first is the paper's start.
STARTS = torch.tensor(
    [
        [29.5, 29.5, 0.0, 1.0, 3.147],
        [15.25, 22.61, -12.93, 1.42, 1.080],
        [16.19, -6.38, -0.75, 1.43, 0.203],
        [1.65, 11.59, -10.09, -1.49, 0.186],
        [-9.19, -2.15, -9.27, 1.12, 0.111],
        [21.62, 23.18, -9.23, -1.06, 1.616],
        [-2.18, -11.22, -0.38, 1.47, 0.180],
        [0.27, 3.31, -13.83, -0.26, 0.035],
        [8.62, 6.79, -10.52, -1.25, 0.210],
        [10.19, 25.17, -12.87, -0.59, 1.035],
        [21.21, 34.35, -7.66, 0.40, 2.725],
        [-0.65, 4.84, -0.84, 0.21, 0.046],
        [-16.79, 2.76, -15.81, 1.55, 0.263],
    ],
    dtype=torch.float64,
)


def learning_curve(seeds: int, times_s: list[float], overrides: list[str]) -> dict[str, list[list[float]]]:
    """Learn with several seeds at once and evaluate what each knew at each time.

    Args:
        seeds: their number.
        times_s: vehicle times, s.
        overrides: of the main configuration.

    Returns:
        `starts`: gap over the twelve starts, one list of percentages (a seed each) for each time; `paper`: likewise for
        the paper's start alone.
    """
    config = compose(["experiment=fig5_free", *overrides])
    validate(config)
    torch.set_num_threads(config.threads)
    env = build.make_relay(config, RandomStreams.replicates(range(seeds), config.device))
    learning, state, records = learn(config, env)
    evaluator = Evaluator(env, build.make_cost(config.cost), progress=config.logging.progress)

    def gaps(weights: Tensor) -> tuple[list[float], list[float]]:
        J = evaluator.cost_of_weights(learning, weights[:, None], state.trim, state.known, STARTS[:, None, :4])
        reference = STARTS[:, 4]
        over_starts = J[:, 1:].sum(1) / reference[1:].sum() - 1.0
        return (100.0 * over_starts).tolist(), (100.0 * (J[:, 0] / reference[0] - 1.0)).tolist()

    curve: dict[str, list[list[float]]] = {"starts": [], "paper": []}
    for time_s in times_s:
        known = [record.actor for record in records if record.seconds <= time_s]
        starts, paper = gaps(known[-1] if known else state.start)
        curve["starts"].append(starts)
        curve["paper"].append(paper)
    return curve


@style.paper
def draw(times_s: list[float], curve: dict[str, list[list[float]]]) -> Figure:
    """Gap against vehicle seconds: median and range over the seeds."""
    figure = style.new(style.COLUMN, 2.5)
    axes = figure.subplots()
    names = {"starts": "twelve starts", "paper": "the paper's start"}
    for (name, values), colour in zip(curve.items(), (BLUE, ORANGE), strict=True):
        gap = torch.tensor(values)
        axes.plot(times_s, gap.quantile(0.5, dim=1), ".-", color=colour, label=names[name])
        axes.fill_between(times_s, gap.amin(1), gap.amax(1), color=colour, alpha=0.2, lw=0.0)
    axes.set(xscale="log", yscale="log", xlabel="vehicle time (s)", ylabel="$J$ above the optimiser's (%)")
    axes.set_title(f"median and range, {len(curve['starts'][0])} seeds")
    axes.set_xticks(times_s, [f"{time:g}" for time in times_s], minor=False)
    axes.set_xticks([], minor=True)
    axes.legend()
    axes.grid(which="both")
    return figure


@hydra.main(version_base="1.3", config_path="conf", config_name="learning_curve")
def main(settings: DictConfig) -> None:
    """Print the table and write it to metrics.json."""
    times = [float(time) for time in settings.times_s]
    with torch.no_grad():
        curve = learning_curve(settings.seeds, times, list(settings.overrides))
    metrics: dict[str, object] = {"times_s": times}
    log.info("%12s %34s %34s", "vehicle (s)", "12 starts: median [min, max] (%)", "paper's start (%)")
    for k, time_s in enumerate(times):
        cells = []
        for name, values in curve.items():
            gap = torch.tensor(values[k])
            cells.append(f"{gap.quantile(0.5):.1f} [{gap.min():.1f}, {gap.max():.1f}]")
            metrics[f"gap_{name}_median_percent_{time_s:g}s"] = float(gap.quantile(0.5))
            metrics[f"gap_{name}_max_percent_{time_s:g}s"] = float(gap.max())
        log.info("%12g %34s %34s", time_s, *cells)
    leave(metrics, draw(times, curve))


if __name__ == "__main__":
    main()
