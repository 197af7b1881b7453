"""Whether readings and the channel estimated from them can be true: sentences on what cannot, before anything is used.

Each limit has its reason beside it. An estimate is doubted only if its whole 99.9 % interval is beyond the limit, so
that few readings are not accused of what they cannot tell.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.estimate import ChannelEstimate
from uwirl.snr.intervals import intervals
from uwirl.world.acoustics import LinkBudget
from uwirl.world.readings import Readings

# Waves lift a transducer by about this height, m. No sea is deeper than the second, m.
WAVES_M, DEEPEST_M = 1.0, 11_000.0
# No tank for experiments with vehicles is smaller, m. Modems are heard over some ten kilometres, far below the second.
SHORTEST_M, LONGEST_M = 0.5, 100e3
# Of the intervals that must be beyond a limit: 7 of 2,400 healthy logs of one sensor along one way, whose readings
# share their shadowing, are accused of their n.
COVERAGE = 0.999
# Cylindrical spreading, the slowest, has n = 1. Interference with the surface has 4, the paper 5: wrong distances, or
# absorption that is left out, have more.
LEAST_N, MOST_N = 0.5, 6.0
# Modems decode at -15 dB with spread codes. A converter of 16 bits has 98 dB between its noise and its largest signal.
LEAST_SNR_DB, MOST_SNR_DB = -25.0, 100.0
# The loudest sonars have 240 dB re 1 uPa at 1 m, and the quietest sea some 40 dB in the band of a modem.
MOST_SNR_AT_1M_DB = 200.0
# The spread of readings around path loss at sea is 2 to 10 dB.
MOST_FADING_DB = 15.0
# Degrees: a site within one of them, which is farther from the origin than this many times its size.
FAR = 100.0
DEGREE_M = 111_195.0
# No survey with so many places of vehicles and of sensors lies within this, m.
TINY_M, SEVERAL = 0.05, 3
# Positions read in another way are better if readings scatter half as much around their line of path loss, and if that
# is this much more likely (natural logarithm); each different distance counts once.
HALF, CERTAIN = 0.5, math.log(1e4)
# Readings of which the share at the upper or lower end is judged, and that share.
MANY, SHARE = 10, 0.5


class ImplausibleError(ValueError):
    """Readings from which no estimate means anything."""


class _Links(NamedTuple):
    """The m readings of a data set: positions of both ends, [m, 3], m, and SNR without what is known of its loss."""

    first: Tensor
    second: Tensor
    snr: Tensor
    budget: LinkBudget

    @classmethod
    def of(cls, readings: Readings, budget: LinkBudget) -> _Links:
        transmitter, receiver = (~readings.snr[0].isnan()).nonzero().unbind(-1)
        first, second = readings.transmitters[transmitter], readings.receivers[receiver]
        return cls(first.cpu(), second.cpu(), readings.snr[0, transmitter, receiver].cpu(), budget)

    @property
    def length(self) -> Tensor:
        return torch.linalg.vector_norm(self.first - self.second, dim=-1)

    def misfit(self) -> tuple[float, float]:
        """Root mean square of the distances from the line of path loss, dB, and its slope n."""
        length = self.length.clamp_min(1e-9)
        x, y = -10.0 * torch.log10(length), self.snr + self.budget.known_loss_dB(length)
        x, y = x - x.mean(), y - y.mean()
        n = float((x * y).sum() / x.square().sum().clamp_min(torch.finfo(x.dtype).tiny))
        return float((y - n * x).square().mean().sqrt()), n

    def is_better(self, other: _Links) -> bool:
        """Whether other positions of the same readings explain them much better."""
        (misfit, _), (others, n) = self.misfit(), other.misfit()
        distances = len(other.length.log10().round(decimals=6).unique())
        gain = math.inf if others == 0.0 else misfit / others
        return gain > 1.0 / HALF and distances * math.log(gain) > CERTAIN and LEAST_N < n < MOST_N


def check_units(readings: Readings, budget: LinkBudget) -> None:
    """Whether positions are in metres.

    Args:
        readings: one data set.
        budget: what is known of links beforehand.

    Raises:
        ImplausibleError: x and y are degrees.
    """
    links = _Links.of(readings, budget)
    places = torch.cat([links.first, links.second])[:, :2]
    low, high = places.amin(0), places.amax(0)
    size, most = float((high - low).max()), places.abs().amax(0)
    if not 0.0 < size < 1.0 or float(most.max()) > 360.0 or float(most.min()) > 90.0:
        return
    if float(torch.linalg.vector_norm(0.5 * (low + high))) < FAR * size:
        return
    # A vertical cast has such positions too, but then the depths explain its readings, and there is one sensor.
    ends = (len(end[:, :2].unique(dim=0)) for end in (links.first, links.second))
    survey = size < TINY_M and min(ends) >= SEVERAL
    if not survey and float(links.length.max()) > SHORTEST_M and float(links.length.max() / links.length.min()) > 1.01:
        # The circles of latitude are shorter, along x or y.
        shorter = [DEGREE_M * abs(math.cos(math.radians(float(x)))) for x in places[0]]
        units = _metres(shorter[1], DEGREE_M), _metres(DEGREE_M, shorter[0])
        if not any(links.is_better(links._replace(first=links.first * m, second=links.second * m)) for m in units):
            return
    x, y = (f"{float(low[k]):.8g} to {float(high[k]):.8g}" for k in range(2))
    raise ImplausibleError(
        f"x ({x}) and y ({y}) look like degrees; positions must be in metres, such as eastings and northings of UTM"
    )


def implausible(readings: Readings, estimate: ChannelEstimate) -> Iterator[str]:
    """What cannot be true, of readings alone and then of what was estimated from them.

    Args:
        readings: one data set.
        estimate: of the channel, from it.

    Yields:
        Sentences on what is wrong, where, and what would be right; none if nothing is.
    """
    links = _Links.of(readings, estimate.budget)
    if len(links.snr) < 3:
        return
    yield from _heights(links)
    yield from _lengths(links)
    yield from _positions(links)
    yield from _level(links.snr)
    yield from _slope(links, estimate)
    yield from _strength(links, estimate)


def _heights(links: _Links) -> Iterator[str]:
    ends = {"vehicles": links.first[:, 2], "sensors": links.second[:, 2]}
    deepest = max(float(z.abs().max()) for z in ends.values())
    if deepest > DEEPEST_M:
        yield f"z goes to {deepest:,.0f} m, deeper than any sea; are positions in millimetres, or columns exchanged?"
        return
    above = {kind: float(z.max()) for kind, z in ends.items() if float(z.max()) > WAVES_M}
    if len(above) == 2 and min(float(z.min()) for z in ends.values()) >= -WAVES_M:
        yield (
            f"all positions lie above the surface, up to {max(above.values()):.3g} m (z is up, the surface is z = 0); "
            "if z is depth, turn its sign in both columns"
        )
        return
    for kind, height in above.items():
        yield (
            f"{kind} lie up to {height:.3g} m above the surface (z is up, the surface is z = 0), and others below it; "
            f"if {kind[:-1]}_z_m is depth, turn its sign"
        )


def _lengths(links: _Links) -> Iterator[str]:
    longest, typical = float(links.length.max()), float(links.length.median())
    if longest < SHORTEST_M:
        yield f"no link is longer than {longest:.2g} m; are positions in kilometres? They must be in metres"
    if typical > LONGEST_M:
        yield (
            f"links are {typical / 1e3:,.0f} km long in the median, but modems are heard over some ten; give all "
            "positions in metres and in one coordinate system"
        )


def _positions(links: _Links) -> Iterator[str]:
    """Columns exchanged, axes turned, and other units of one end, if that explains the readings much better."""
    first, second = links.first, links.second
    others = {
        "x and y of the sensors (or of the vehicles) exchanged": links._replace(second=second[:, [1, 0, 2]]),
        "the sign of x of the sensors (or of the vehicles) turned": links._replace(second=second * _metres(-1.0, 1.0)),
        "the sign of y of the sensors (or of the vehicles) turned": links._replace(second=second * _metres(1.0, -1.0)),
    }
    # A log in millimetres at one end cannot be told from one in kilometres at the other.
    for unit, other, m in (("feet", "", 0.3048), ("cm", "", 1e-2), ("mm", " (or {} in km)", 1e-3)):
        others[f"vehicles in {unit}{other.format('sensors')}"] = links._replace(first=first * m)
        others[f"sensors in {unit}{other.format('vehicles')}"] = links._replace(second=second * m)
    best = min(others, key=lambda name: others[name].misfit()[0])
    if links.is_better(others[best]):
        before, after = links.misfit()[0], others[best].misfit()[0]
        yield (
            f"with {best} readings scatter by {after:.2g} dB around path loss instead of {before:.2g} dB; "
            "check units and columns of positions"
        )


def _metres(x: float, y: float) -> Tensor:
    return torch.tensor([x, y, 1.0], dtype=torch.float64)


def _level(snr: Tensor) -> Iterator[str]:
    median = float(snr.median())
    if median < LEAST_SNR_DB:
        yield (
            f"snr_dB is {median:.3g} dB in the median, less than any modem needs; is it received power (dBm), or a "
            "level? Subtract the noise"
        )
    if median > MOST_SNR_DB:
        yield (
            f"snr_dB is {median:.3g} dB in the median, more than any receiver resolves; is it a received level (dB re "
            "1 uPa)? Subtract the noise"
        )
    values, counts = snr.unique(return_counts=True)
    for end, word in ((0, "smallest"), (-1, "largest")):
        share = float(counts[end]) / len(snr)
        # Numbers that are rounded coarsely may often be the same, but then scatter by little more than a step.
        if (
            len(snr) < MANY
            or share <= SHARE
            or (len(values) > 1 and float(snr.std()) < 3.0 * float(values.diff().min()))
        ):
            continue
        if len(values) == 1:
            yield f"all readings are {float(values[0]):.4g} dB, at any distance; is snr_dB a placeholder or a limit?"
            return
        yield (
            f"{share:.0%} of the readings are {float(values[end]):.4g} dB, the {word}; is that the receiver's limit? "
            "Such readings tell no distance: leave them blank"
        )


def _slope(links: _Links, estimate: ChannelEstimate) -> Iterator[str]:
    if not bool(estimate.identifiable[0, 1]):
        return
    low, high = intervals(estimate, len(links.snr), COVERAGE)[0, 1].tolist()
    ordinary = float(intervals(estimate, len(links.snr))[0, 1, 1])
    found = f"n = {float(estimate.value[0, 1]):.3g} (99.9 %: {low:.3g} .. {high:.3g})"
    if high < 0.0:
        absorbed = float(links.length.max()) * estimate.budget.absorption_dB_per_km / 1000.0
        yield (
            f"{found}: the SNR grows with distance; is snr_dB a loss, are columns of positions exchanged, or is the "
            f"absorption of channel.frequency_khz too much ({absorbed:.3g} dB over the longest link)?"
        )
    elif high < LEAST_N or (float(estimate.value[0, 1]) < LEAST_N and ordinary < 1.0):
        yield f"{found}: the SNR hardly falls with distance; check snr_dB, and the positions' units and columns"
    elif low > MOST_N:
        yield f"{found}: the SNR falls faster than at sea; check units and signs of positions, and channel.absorption"
    low, high = intervals(estimate, len(links.snr))[0, 1].tolist()
    if low < LEAST_N and high > MOST_N:
        shortest, longest = (f"{float(x):.4g}" for x in links.length.aminmax())
        yield (
            f"n lies anywhere between {low:.3g} and {high:.3g}: links of {shortest} to {longest} m do not tell how the "
            "SNR falls with distance; add shorter and longer ones"
        )


def _strength(links: _Links, estimate: ChannelEstimate) -> Iterator[str]:
    low = float(intervals(estimate, len(links.snr), COVERAGE)[0, 0, 0])
    if low - estimate.budget.N0_dB > MOST_SNR_AT_1M_DB:
        yield (
            f"K - N0 = {float(estimate.value[0, 0]) - estimate.budget.N0_dB:.0f} dB at 1 m, louder than any source; "
            "check units of positions, channel.absorption and channel.frequency_khz"
        )
    fading = math.sqrt(float(estimate.value[0, 2] + estimate.value[0, 4]))
    # The standard error of a standard deviation from m readings, twice.
    if fading * (1.0 - 2.0 / math.sqrt(2.0 * len(links.snr))) > MOST_FADING_DB:
        yield (
            f"readings scatter by {fading:.0f} dB around path loss, more than at sea (2 to 10 dB); check snr_dB, and "
            "the positions' units and columns"
        )
