"""How often the map of the SNR holds what it promises, and how often it accuses healthy sensors.

    python experiments/map_coverage.py

For each channel and number of sensors, one message from the paper's start: the percentages of unmeasured links, and of
readings there, within two standard deviations of the map. Then campaigns of standing stations: the same, with the
fading left open and with it plugged in, and the percentage of healthy logs in which a sensor is accused.
"""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import NamedTuple

import hydra
import torch
from omegaconf import DictConfig
from results import leave
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.snr.diagnostics import diagnose
from uwirl.snr.estimators import maximum_likelihood
from uwirl.snr.integrated_kriging import IntegratedKriging
from uwirl.snr.kriging import Kriging
from uwirl.snr.links import Links
from uwirl.snr.posterior import FadingPosterior
from uwirl.study.estimate_report import FALSE_ALARM
from uwirl.study.progress import bar
from uwirl.world.acoustics import Channel
from uwirl.world.fading import exact_shadowing
from uwirl.world.geometry import distances
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.readings import Readings
from uwirl.world.scenario import spread_sensors

log = logging.getLogger("uwirl")


class Sea(NamedTuple):
    """B data sets from the same places, and the truth where nobody listened.

    Attributes:
        readings: B data sets.
        places: unmeasured ends of links, [Q, 3], m.
        link: their SNR without multipath, [B, Q], dB.
        reading: with multipath, [B, Q], dB.
    """

    readings: Readings
    places: Tensor
    link: Tensor
    reading: Tensor


def simulate(channel: Channel, sender: Tensor, places: Tensor, sizes: tuple[int, int, int], seed: int) -> Sea:
    """Of sizes (data sets, sensors, pings): the first places have sensors, which hear every ping."""
    sets, sensors, pings = sizes
    streams, count = RandomStreams.worlds(seed, sets), len(places)
    white = streams.normal(Stream.CHANNEL, 0, count).view(sets, 1, count)
    multipath = channel.rho_dB * streams.normal(Stream.MEASUREMENT, 0, pings * count).view(sets, pings, count)
    link = channel.mean_snr_dB(distances(sender, places))
    link = link + exact_shadowing(sender, places, float(channel.zeta_dB), float(channel.varphi_m), white)
    heard = (link + multipath)[..., :sensors]
    reading = link[:, 0, sensors:] + multipath[:, 0, sensors:]
    return Sea(
        Readings(sender.expand(pings, 3), places[:sensors], heard), places[sensors:], link[:, 0, sensors:], reading
    )


def around(count: int, reach: float, seed: int) -> Tensor:
    """Places between 20 m and `reach` from the origin, at its depth of 5 m, [count, 3]."""
    draws = RandomStreams.worlds(seed, 1).uniform(Stream.SENSOR_PLACEMENT, 0, 2 * count).view(count, 2)
    radius, angle = 20.0 + (reach - 20.0) * draws[:, 0], 2.0 * math.pi * draws[:, 1]
    return torch.stack([radius * angle.cos(), radius * angle.sin(), torch.full_like(radius, -5.0)], -1)


def within(truth: Tensor, prediction: tuple[Tensor, Tensor]) -> float:
    """Percentage within two standard deviations."""
    mean, std = prediction
    return 100.0 * float(((truth - mean).abs() < 2.0 * std).double().mean())


def covered(sea: Sea, channel: Channel) -> Tensor:
    """Percentages of links and of readings within two standard deviations, [2]."""
    kriging, sender = IntegratedKriging.of(sea.readings, channel.budget), sea.readings.transmitters[0]
    link, reading = (kriging.predict(sender, sea.places, multipath) for multipath in (False, True))
    return torch.tensor([within(sea.link, link), within(sea.reading, reading)])


def messages(settings: DictConfig, name: str, sensors: int) -> dict[str, float]:
    """One message from the paper's start to sensors spread at random."""
    config = compose([f"channel={name}", "experiment=fig5_free"])
    scenario, channel = build.make_scenario(config), build.make_channel(config.channel)
    ends, start = (scenario.source.tolist(), scenario.destination.tolist()), scenario.start[:1, :3].double()
    parts = []
    with bar(f"{name}, {sensors} sensors", settings.layouts) as progress:
        for seed in range(settings.seed, settings.seed + settings.layouts):
            places = spread_sensors(sensors + settings.unmeasured, seed, *ends, torch.float64)
            sizes = settings.data_sets // settings.layouts, sensors, 1
            parts.append(covered(simulate(channel, start, places, sizes, seed), channel))
            progress.update()
    link, reading = torch.stack(parts).mean(0).tolist()
    log.info("%-15s %3d sensors: %.1f %% of links, %.1f %% of readings", name, sensors, link, reading)
    return {f"{name}_{sensors}_links_percent": link, f"{name}_{sensors}_readings_percent": reading}


def campaigns(settings: DictConfig, varphi: float) -> dict[str, float]:
    """Standing stations: coverage of the first `campaigns` logs, accusations in `healthy_logs`."""
    channel = replace(build.make_channel(compose(["channel=acoustic_24khz"]).channel), varphi_m=varphi)
    sender = torch.tensor([[0.0, 0.0, -5.0]], dtype=torch.float64)
    parts, plugged, alarms = [], [], []
    with bar(f"standing stations, {varphi:g} m", settings.healthy_logs) as progress:
        for k in range(settings.healthy_logs):
            seed = settings.seed + k
            places = around(settings.stations + settings.unmeasured, settings.reach_m, seed)
            sea = simulate(channel, sender, places, (1, settings.stations, settings.pings), seed)
            if k < settings.campaigns:
                parts.append(covered(sea, channel))
                plug = Kriging(sea.readings, maximum_likelihood(sea.readings, channel.budget).channel)
                plugged.append(within(sea.link, plug.predict(sender[0], sea.places)))
            posterior = FadingPosterior.coarse(Links.of(sea.readings, channel.budget))
            alarms.append(bool(diagnose(sea.readings, posterior).accused(FALSE_ALARM)))
            progress.update()
    link, reading = torch.stack(parts).mean(0).tolist()
    before, first = sum(plugged) / len(plugged), sum(alarms[: settings.campaigns])
    rate = 100.0 * sum(alarms) / len(alarms)
    log.info(
        "stations, varphi %3g m: %.1f %% of links (%.1f %% plugged in), %.1f %% of readings; accused %d of %d, %.2f %%",
        *(varphi, link, before, reading, first, settings.campaigns, rate),
    )
    return {
        f"stations_{varphi:g}_links_percent": link,
        f"stations_{varphi:g}_plugged_in_links_percent": before,
        f"stations_{varphi:g}_readings_percent": reading,
        f"stations_{varphi:g}_accused_campaigns": first,
        f"stations_{varphi:g}_accused_percent": rate,
    }


@torch.no_grad()
def study(settings: DictConfig) -> dict[str, float]:
    """All rows; prints each as soon as it is there."""
    metrics: dict[str, float] = {}
    for varphi in settings.correlation_distances_m:
        metrics |= campaigns(settings, varphi)
    for name in settings.channels:
        for sensors in settings.sensors:
            metrics |= messages(settings, name, sensors)
    return metrics


@hydra.main(version_base="1.3", config_path="conf", config_name="map_coverage")
def main(settings: DictConfig) -> None:
    """Print the table and write metrics.json."""
    torch.set_num_threads(1)
    leave(study(settings))


if __name__ == "__main__":
    main()
