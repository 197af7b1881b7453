"""Fig. 2: the SNR of links from the source: path loss, with shadowing, with multipath, with both; and its statistics.

    python experiments/fig2_channel.py
    python experiments/fig2_channel.py "overrides=['channel=paper']"

Drawn by default for the modem at 24 kHz: the fading that the paper prints is a few tenths of a dB, under a path loss of
100 dB, and only the last panel shows it. Shadowing is the field that missions fly through, multipath is drawn anew for
each point.

Needs matplotlib (extra `plot`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import hydra
import torch
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from omegaconf import DictConfig
from results import leave, tell
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.config.validate import validate
from uwirl.study import style
from uwirl.study.colours import BLUE, ORANGE
from uwirl.study.shadowing import map_grid
from uwirl.world.acoustics import Channel
from uwirl.world.fading import Shadowing, ShadowingField
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario
from uwirl.world.truth import truth_of

TITLES = (
    "(a) path loss",
    "(b) path loss and shadowing",
    "(c) path loss and multipath",
    "(d) path loss, shadowing and multipath",
)
# Points of a link's field that are worked out at once.
CHUNK = 20_000
CUT_POINTS = 800
# Steps of the multipath stream, one for each place where it is drawn.
ON_MAP, ON_CUT = 0, 1


class Fields(NamedTuple):
    """Of links from the source to [n] places.

    Attributes:
        mean: path loss, dB.
        shadowing: dB.
        multipath: dB.
    """

    mean: Tensor
    shadowing: Tensor
    multipath: Tensor

    @property
    def panels(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """SNR as in TITLES, dB."""
        mean, shadowing, multipath = self
        return mean, mean + shadowing, mean + multipath, mean + shadowing + multipath


def fields(env: Relay, places: Tensor, step: int) -> Fields:
    """At places [n, 3], m, in the first world; `step` tells draws of multipath apart."""
    source, truth = env.scenario.source, truth_of(env)
    shadowing = [truth.shadowing(source.expand_as(part)[None], part[None])[0] for part in places.split(CHUNK)]
    multipath = env.streams.normal(Stream.MEASUREMENT, step, len(places))[0] * truth.channel.rho_dB
    mean = truth.channel.mean_snr_dB(torch.linalg.vector_norm(places - source, dim=-1))
    return Fields(mean, torch.cat(shadowing), multipath)


def correlation(field: ShadowingField, source: Tensor, places: Tensor, lag: float) -> tuple[Tensor, Tensor]:
    """Power of the shadowing over places [n, 3], dB^2, and its covariance with that `lag` m off, [B] each."""
    here, there = [], []
    for part in places.split(CHUNK // 20):
        value = field(source.expand_as(part)[None], part[None])
        for axis in range(2):
            shifted = part.clone()
            shifted[:, axis] += lag
            here.append(value)
            there.append(field(source.expand_as(part)[None], shifted[None]))
    one, other = torch.cat(here, -1), torch.cat(there, -1)
    return one.square().mean(-1), (one * other).mean(-1)


def statistics(env: Relay, places: Tensor, drawn: Fields, worlds: int) -> dict[str, float]:
    """The channel's fading, and what the map holds of it: of one world, and shadowing of many.

    Args:
        env: the world of the map.
        places: the map's, [n, 3], m.
        drawn: there.
        worlds: how many.
    """
    truth, seed = truth_of(env), int(env.streams.seed[0])
    zeta, varphi = float(truth.channel.zeta_dB), float(truth.channel.varphi_m)
    # Among many worlds a coarser map serves as well.
    some = places[:: max(1, len(places) // 1000)]
    many = Shadowing(zeta, varphi).realise(RandomStreams.worlds(seed, worlds))
    power, covariance = correlation(many, env.scenario.source, some, varphi)
    own_power, own_covariance = correlation(truth.shadowing, env.scenario.source, some, varphi)
    return {
        "zeta_dB": zeta,
        "shadowing_std_map_dB": float(drawn.shadowing.square().mean().sqrt()),
        "shadowing_std_worlds_dB": float(power.mean().sqrt()),
        "varphi_m": varphi,
        "correlation_at_varphi": math.exp(-1.0),
        "correlation_at_varphi_map": float(own_covariance / own_power),
        "correlation_at_varphi_worlds": float(covariance.mean() / power.mean()),
        "rho_dB": float(truth.channel.rho_dB),
        "multipath_std_map_dB": float(drawn.multipath.square().mean().sqrt()),
    }


def draw_map(
    axes: Axes, x: Tensor, y: Tensor, snr: Tensor, levels: Tensor, scenario: Scenario, lines: bool
) -> ContourSet:
    """One of (a) to (d): SNR [Y, X] over x and y."""
    filled = axes.contourf(x, y, snr, levels, cmap="cividis", extend="both")
    filled.set_edgecolor("face")
    if lines:
        axes.contour(x, y, snr, levels, colors="white", linestyles="solid", linewidths=0.4, alpha=0.8)
    source, destination = scenario.source.tolist(), scenario.destination.tolist()
    axes.plot(*zip(source[:2], destination[:2], strict=True), "--", color="white", lw=0.8)
    axes.plot(*source[:2], "s", color=ORANGE, mec="white", mew=0.6, ms=5, ls="none", label="source")
    axes.plot(*destination[:2], "D", color=ORANGE, mec="white", mew=0.6, ms=5, ls="none", label="destination")
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)", aspect="equal")
    return filled


def draw_cut(snr: Axes, fading: Axes, distance: Tensor, drawn: Fields, channel: Channel) -> None:
    """(e) and (f): along the line to the destination."""
    mean, shadowed, _, everything = drawn.panels
    snr.plot(distance, everything, ".", color="0.6", ms=1.5, label="with multipath")
    snr.plot(distance, shadowed, color=BLUE, label="with shadowing")
    snr.plot(distance, mean, "--", color=ORANGE, label="path loss")
    snr.set(ylabel="SNR (dB)")
    snr.set_title("(e) along the dashed line")
    fading.plot(distance, drawn.shadowing + drawn.multipath, ".", color="0.6", ms=1.5, label="with multipath")
    fading.plot(distance, drawn.shadowing, color=BLUE, label="shadowing")
    for std, colour, name in ((channel.zeta_dB, BLUE, "\\zeta"), (math.hypot(*_stds(channel)), "0.6", "")):
        label = f"$\\pm {name}$" if name else "$\\pm \\sqrt{\\zeta^2 + \\rho^2}$"
        for sign in (-1.0, 1.0):
            fading.axhline(sign * float(std), color=colour, ls=":", label=label if sign > 0 else None)
    fading.axhline(0.0, color=ORANGE, ls="--")
    fading.set(ylabel="fading (dB)")
    fading.set_title("(f) the same less path loss")
    for axes in (snr, fading):
        axes.set_xlabel("distance from the source $l$ (m)")
        axes.grid()
    snr.legend(loc="upper right")
    fading.legend(loc="lower right", ncols=2, columnspacing=0.8)
    low, high = fading.get_ylim()
    fading.set_ylim(low - 0.35 * (high - low), high)


def _stds(channel: Channel) -> tuple[float, float]:
    return float(channel.zeta_dB), float(channel.rho_dB)


@style.paper
def study(settings: DictConfig) -> tuple[dict[str, float | str], Figure]:
    """The numbers of metrics.json and the figure."""
    config = compose(list(settings.overrides))
    validate(config)
    env = build.make_relay(config)
    source, destination = env.scenario.source.double(), env.scenario.destination.double()
    x, y = map_grid(env, spacing_m=settings.spacing_m)
    # Half a spacing off, so that no node lies on the source, where the SNR is infinite.
    x, y = (axis[:-1] + 0.5 * settings.spacing_m for axis in (x, y))
    across, along = torch.meshgrid(y, x, indexing="ij")
    places = torch.stack([along, across, torch.full_like(along, float(source[2]))], -1).flatten(0, 1)
    drawn = fields(env, places, ON_MAP)
    metrics = statistics(env, places, drawn, settings.worlds)

    length = float(torch.linalg.vector_norm(destination - source))
    distance = torch.linspace(settings.nearest_m, length, CUT_POINTS, dtype=torch.float64)
    cut = fields(env, source + distance[:, None] / length * (destination - source), ON_CUT)

    figure = style.new(style.PAGE, 8.4)
    panels = figure.subplots(3, 2, gridspec_kw={"height_ratios": [1.0, 1.0, 0.62]}).flatten().tolist()
    # Beside the source the SNR would take all colours.
    low, high = drawn.panels[3].quantile(torch.tensor([0.002, 0.985], dtype=drawn.mean.dtype)).tolist()
    step = max(1, round((high - low) / 24.0))
    levels = step * torch.arange(math.floor(low / step), math.ceil(high / step) + 1)
    for axes, snr, title in zip(panels[:4], drawn.panels, TITLES, strict=True):
        filled = draw_map(axes, x, y, snr.view(len(y), len(x)), levels, env.scenario, title is TITLES[0])
        axes.set_title(title)
    panels[0].legend(loc="lower right", facecolor="0.4", labelcolor="white", framealpha=1.0)
    label = f"SNR of links from the source, z = {float(source[2]):g} m (dB)"
    # Left to itself it counts from the lowest level on, and names numbers that are not round.
    figure.colorbar(filled, ax=panels[:4], label=label, aspect=40, shrink=0.9, ticks=levels[levels % (5 * step) == 0])
    draw_cut(panels[4], panels[5], distance, cut, truth_of(env).channel)
    return {"overrides": " ".join(settings.overrides), **metrics}, figure


@hydra.main(version_base="1.3", config_path="conf", config_name="fig2_channel")
def main(settings: DictConfig) -> None:
    """Draw the figure and write the numbers to metrics.json."""
    torch.set_num_threads(1)
    metrics, figure = study(settings)
    tell(metrics)
    leave(metrics, figure)


if __name__ == "__main__":
    main()
