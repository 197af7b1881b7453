"""The figure of `uwirl-estimate`; needs matplotlib (extra `plot`)."""

from __future__ import annotations

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatter, MaxNLocator
from torch import Tensor

from uwirl.snr.diagnostics import Diagnostics
from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.intervals import student_t
from uwirl.study import style
from uwirl.study.colours import BLUE, ORANGE
from uwirl.study.snr_map import SnrMap
from uwirl.world.readings import Readings

GREY = "0.45"
LEVELS = 14
# More markers would hide the map.
MOST_NAMES = 12


@style.paper
def estimate_figure(
    readings: Readings, estimate: ChannelEstimate, diagnostics: Diagnostics, snr_map: SnrMap, names: tuple[str, ...]
) -> Figure:
    """SNR against distance, maps of SNR, its uncertainty and outage, residuals against normal, semivariogram.

    Args:
        readings: one data set.
        estimate: its estimate.
        diagnostics: diagnostics of readings and estimate.
        snr_map: map of the links from one place.
        names: names of the sensors, [N].
    """
    figure = style.new(style.PAGE, 8.4)
    panels = figure.subplots(3, 2).flatten().tolist()
    _path_loss(panels[0], readings, estimate)
    # The high SNR close to the sender would use the whole colour range.
    most = float(snr_map.mean[~snr_map.mean.isnan()].quantile(0.99))
    least = float(snr_map.mean.nan_to_num(most).min())
    _map(panels[1], snr_map, snr_map.mean, readings, "expected SNR", "SNR (dB)", (least, most))
    spread = (0.0, float(snr_map.std.nan_to_num(0.0).max()))
    _map(panels[2], snr_map, snr_map.std, readings, "its standard deviation", "standard deviation (dB)", spread)
    title = f"probability of less than {snr_map.threshold:.3g} kbit/s"
    _map(panels[3], snr_map, snr_map.outage, readings, title, "outage probability", (0.0, 1.0))
    _quantiles(panels[4], diagnostics)
    _semivariogram(panels[5], diagnostics, estimate)
    # Sensors without names have their positions as names, which the axes show already.
    if len(names) <= MOST_NAMES and not any(name.startswith("(") for name in names):
        _names(panels[1], readings.receivers, names)
    panels[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3, frameon=False)
    style.letter(panels)
    sender = ", ".join(f"{x:.3g}" for x in snr_map.sender.tolist())
    figure.suptitle(f"(b) to (d): links from the sender at ({sender}) m to the plane z = {snr_map.grid.z:.3g} m")
    return figure


def _path_loss(axes: Axes, readings: Readings, estimate: ChannelEstimate) -> None:
    distance, snr = readings.distance.flatten(), readings.snr[0].flatten()
    axes.plot(distance, snr, "o", color=BLUE, ms=3, alpha=0.6, mec="none", label="readings")
    low, high = distance.min(), distance.max()
    l = torch.logspace(float(low.log10()), float(high.log10()), 200, dtype=torch.float64)
    mean = estimate.channel.mean_snr_dB(l)
    H = torch.stack([torch.ones_like(l), -10.0 * torch.log10(l)], -1)
    theta = ((H @ estimate.covariance[0, :2, :2]) * H).sum(-1)
    t = student_t(0.95, max(1, int((~snr.isnan()).sum()) - 2))
    fading = float(estimate.channel.zeta_dB**2 + estimate.channel.rho_dB**2)
    axes.plot(l, mean, color=ORANGE, label="path loss")
    for variance, alpha, label in ((theta + fading, 0.15, "95 % of readings"), (theta, 0.35, "95 % of the path loss")):
        half = t * variance.sqrt()
        axes.fill_between(l, mean - half, mean + half, color=ORANGE, alpha=alpha, lw=0.0, label=label)
    axes.set(xscale="log", xlabel="distance $l$ (m)", ylabel="SNR (dB)", title="SNR against distance")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(LogFormatter(minor_thresholds=(1.5, 0.6)))
    axes.grid(which="both")
    axes.legend()


def _map(
    axes: Axes,
    snr_map: SnrMap,
    values: Tensor,
    readings: Readings,
    title: str,
    label: str,
    shown: tuple[float, float],
) -> None:
    levels = MaxNLocator(LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(shown[0], max(shown[1], shown[0] + 1e-3))
    # Contours fill values above the lowest level, not equal to it.
    above = np.ma.masked_invalid(values.clamp_min(float(levels[0]) + 1e-6))
    beyond = "max" if float(values.nan_to_num(shown[0]).max()) > levels[-1] else "neither"
    x, y = snr_map.grid.x, snr_map.grid.y
    filled = axes.contourf(x, y, above, levels, cmap="cividis", extend=beyond)
    filled.set_edgecolor("face")
    axes.figure.colorbar(filled, ax=axes, label=label)
    axes.plot(*readings.transmitters[:, :2].T, ".", color="white", mec="black", mew=0.4, ms=4, label="vehicle")
    axes.plot(*readings.receivers[:, :2].T, "^", color=ORANGE, mec="white", mew=0.5, ms=5, ls="none", label="sensor")
    axes.plot(*snr_map.sender[:2], "*", color="white", mec="black", mew=0.5, ms=9, ls="none", label="sender")
    axes.set(xlabel="$x$ (m)", ylabel="$y$ (m)", title=title, aspect="equal")


def _names(axes: Axes, places: Tensor, names: tuple[str, ...]) -> None:
    """Write names alternately above and below the sensors, from left to right, so that neighbours do not overlap."""
    order = places[:, 0].argsort().tolist()
    for turn, k in enumerate(order):
        offset = (0.0, 6.5 if turn % 2 else -6.5)
        x, y = places[k, :2].tolist()
        text = axes.annotate(names[k], (x, y), offset, textcoords="offset points", fontsize=6, color="white")
        text.set(ha="center", va="center", path_effects=[withStroke(linewidth=1.5, foreground="0.2")])


def _quantiles(axes: Axes, diagnostics: Diagnostics) -> None:
    z = diagnostics.standardized[~diagnostics.standardized.isnan()].sort().values
    m = len(z)
    normal = torch.special.ndtri((torch.arange(m, dtype=z.dtype) + 0.5) / m)
    # Pointwise band: standard deviation of an order statistic, to first order.
    share = torch.special.ndtr(normal)
    density = torch.exp(-0.5 * normal.square()) / (2.0 * torch.pi) ** 0.5
    half = 1.96 * (share * (1.0 - share) / m).sqrt() / density
    axes.fill_between(normal, normal - half, normal + half, color=GREY, alpha=0.25, lw=0.0, label="95 % if normal")
    axes.axline((0.0, 0.0), slope=1.0, color=GREY)
    axes.plot(normal, z, "o", color=BLUE, ms=3, label="readings")
    axes.set(xlabel="normal quantile", ylabel="residual / its standard deviation")
    axes.set_title("readings against what the others predict")
    axes.grid()
    axes.legend(loc="upper left")


def _semivariogram(axes: Axes, diagnostics: Diagnostics, estimate: ChannelEstimate) -> None:
    bins = diagnostics.semivariogram
    zeta2, varphi, rho2 = estimate.value[0, 2:].tolist()
    known = bool(estimate.identifiable[0, 2:].all())
    fit = f"$\\zeta^2 = {zeta2:.2f}$, $\\varphi = {varphi:.1f}$ m, $\\rho^2 = {rho2:.2f}$"
    label = f"fitted: {fit}" if known else "mean of all fading that is possible"
    axes.plot(bins.distance, bins.empirical, "o", color=BLUE, label="what path loss leaves")
    axes.plot(bins.distance, bins.fitted, color=ORANGE, label=label)
    axes.set(xlabel="distance between links $|p - p'| + |q - q'|$ (m)", ylabel="semivariogram (dB$^2$)")
    axes.set_title("likeness of neighbouring links")
    axes.set_ylim(bottom=0.0)
    axes.grid()
    axes.legend(loc="lower right")
