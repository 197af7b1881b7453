"""How far estimates of the channel lie from the Cramer-Rao bound, and whether their intervals hold what they promise.

    python experiments/estimators.py

For each channel, number of sensors N and of messages S: root mean square error over the square root of the bound, for
K, n, zeta^2, varphi and rho^2; coverage in percent of 95 % intervals (Student t with m - 2 degrees of freedom for K and
n; normal and of the logarithm for the others, of those data sets that tell it), and how often each is told, in percent.
Where little is told, errors may lie below the bound, which is that of unbiased estimates. No estimator sees the truth.
"""

from __future__ import annotations

import logging
import time
from typing import Any, NamedTuple

import hydra
import torch
from omegaconf import DictConfig
from results import leave
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.snr.estimators import ESTIMATORS
from uwirl.snr.information import cramer_rao_bound
from uwirl.snr.intervals import intervals
from uwirl.snr.model import Fading, observations
from uwirl.study.progress import bar
from uwirl.world.acoustics import Channel
from uwirl.world.fading import exact_shadowing
from uwirl.world.geometry import distances
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.readings import Readings
from uwirl.world.scenario import Scenario, spread_sensors

log = logging.getLogger("uwirl")

LOGARITHMIC = torch.tensor([False, False, True, True, True])


class Errors(NamedTuple):
    """Of B data sets and five parameters.

    Attributes:
        relative: error over the square root of the bound, [B, 5].
        covered: whether the 95 % interval holds the truth, bool [B, 5].
        told: bool [B, 5].
    """

    relative: Tensor
    covered: Tensor
    told: Tensor


def simulate(scenario: Scenario, channel: Channel, size: tuple[int, int], layout: int, data_sets: int) -> Readings:
    """Data sets read at the same places, [B, S, N]."""
    N, S = size
    ends = scenario.source.tolist(), scenario.destination.tolist()
    # Vehicles and sensors from one draw, so that no vehicle lies on a sensor.
    places = spread_sensors(N + S - 1, layout, *ends, torch.float64)
    transmitters, sensors = torch.cat([scenario.start[:1, :3].double(), places[N:]]), places[:N]
    streams = RandomStreams.worlds(layout, data_sets)
    shape = data_sets, S, N
    white = streams.normal(Stream.CHANNEL, S, S * N).view(shape)
    shadowing = exact_shadowing(transmitters, sensors, float(channel.zeta_dB), float(channel.varphi_m), white)
    multipath = channel.rho_dB * streams.normal(Stream.MEASUREMENT, S, S * N).view(shape)
    return Readings(
        transmitters, sensors, channel.mean_snr_dB(distances(transmitters, sensors)) + shadowing + multipath
    )


def judge(readings: Readings, channel: Channel, estimate: ChannelEstimate) -> Errors:
    """Estimates against the truth and the bound."""
    truth = torch.tensor(
        [channel.K_dB, channel.n, channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2], dtype=torch.float64
    )
    _, _, geometry = next(observations(readings, channel.budget))
    bound = cramer_rao_bound(geometry, Fading(*truth[2:])).diagonal().sqrt()
    # The bound is that of logarithms.
    relative = (estimate.value - truth) / (bound * torch.where(LOGARITHMIC, truth, 1.0))
    low, high = intervals(estimate, geometry.readings).unbind(-1)
    covered = (low < truth) & (truth < high)
    return Errors(relative, covered, estimate.identifiable)


def row(errors: Errors) -> dict[str, float | None]:
    """Figures of one estimator, by parameter."""
    figures: dict[str, float | None] = {}
    for k, name in enumerate(NAMES):
        told = errors.told[:, k]
        covered = errors.covered[told, k].double()
        figures[f"rmse_over_bound_{name}"] = float(errors.relative[:, k].square().mean().sqrt())
        figures[f"coverage_percent_{name}"] = 100.0 * float(covered.mean()) if len(covered) else None
        figures[f"told_percent_{name}"] = 100.0 * float(told.double().mean())
    return figures


def line(title: str, figures: dict[str, float | None], milliseconds: float) -> str:
    """One line of the table."""

    def texts(kind: str, width: int, digits: int) -> str:
        values = (figures[f"{kind}_{name}"] for name in NAMES)
        return " ".join(f"{'-' if v is None else f'{v:.{digits}f}':>{width}}" for v in values)

    return (
        f"{title} | {texts('rmse_over_bound', 6, 3)} | {texts('coverage_percent', 5, 1)} "
        f"| {texts('told_percent', 5, 1)} | {milliseconds:8.2f}"
    )


@torch.no_grad()
def study(settings: DictConfig) -> dict[str, Any]:
    """All rows; prints each as soon as it is there."""
    metrics: dict[str, Any] = {}
    log.info("%-15s %4s %3s %-26s | RMSE / bound | coverage, %% | told, %% | ms", "channel", "N", "S", "estimator")
    for name in settings.channels:
        config = compose([f"channel={name}", "experiment=fig5_free"])
        scenario, channel = build.make_scenario(config), build.make_channel(config.channel)
        for size in settings.sizes:
            parts: dict[str, list[Errors]] = {estimator: [] for estimator in settings.estimators}
            spent = dict.fromkeys(parts, 0.0)
            with bar(f"estimating {name} {size[0]} x {size[1]}", settings.layouts * len(parts)) as progress:
                for layout in range(settings.seed, settings.seed + settings.layouts):
                    readings = simulate(scenario, channel, tuple(size), layout, settings.data_sets // settings.layouts)
                    for estimator in parts:
                        begin = time.process_time()
                        estimate = ESTIMATORS[estimator](readings, channel.budget)
                        spent[estimator] += time.process_time() - begin
                        parts[estimator].append(judge(readings, channel, estimate))
                        progress.update()
            for estimator, errors in parts.items():
                joined = Errors(*(torch.cat(pieces) for pieces in zip(*errors, strict=True)))
                figures = row(joined)
                title = f"{name:<15} {size[0]:>4} {size[1]:>3} {estimator:<26}"
                milliseconds = 1e3 * spent[estimator] / settings.data_sets
                log.info(line(title, figures, milliseconds))
                prefix = f"{name}_{size[0]}_{size[1]}_{estimator}"
                metrics |= {f"{prefix}_{key}": value for key, value in figures.items()}
    return metrics


@hydra.main(version_base="1.3", config_path="conf", config_name="estimators")
def main(settings: DictConfig) -> None:
    """Print the table and write metrics.json."""
    torch.set_num_threads(1)
    leave(study(settings))


if __name__ == "__main__":
    main()
