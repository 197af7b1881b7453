"""Check of the model (9)-(13) by cross validation, and tests of sensors and readings, whatever the fading may be.

With P = Omega^-1 - Omega^-1 H (H' Omega^-1 H)^-1 H' Omega^-1, an offset of unknown size along u (1 for the readings of
a link or of a sensor, or for one reading, and 0 for the others) is estimated as

    u' P (Y + epsilon) / (u' P u),   with the variance 1 / (u' P u)

For a link or a reading this is its difference from what the others predict (O. Dubrule: "Cross validation of kriging in
a unique neighborhood", Mathematical Geology 15, 687-699, 1983). K and n are fitted without it, and so is the posterior
of the fading (`uwirl.snr.posterior`). Readings of a link are left out together, because they share its shadowing. A
healthy sensor has an offset, too, because of its shadowing: with a single link it differs from others as links do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.snr.links import Links
from uwirl.snr.posterior import NOTHING, FadingPosterior
from uwirl.world.readings import Readings

BINS = 20
# Pairs farther apart than this fraction of the longest distance are few, and are not used.
REACH = 0.5


class Semivariogram(NamedTuple):
    """Half the mean square difference of residuals against the distance between links, |p - p'| + |q - q'|.

    Attributes:
        distance: mean of each bin, [k], m.
        empirical: [k], dB^2.
        fitted: rho^2 + zeta^2 (1 - exp(-distance / varphi)), [k], dB^2.
        pairs: number of pairs, [k].
    """

    distance: Tensor
    empirical: Tensor
    fitted: Tensor
    pairs: Tensor


class Offsets(NamedTuple):
    """Estimated offsets along K directions; nan if path loss explains them as well.

    Attributes:
        mean: [K], dB.
        standardized: mean divided by its standard deviation, [K].
        p: probability of an offset as large as this, or larger, if there is none, [K].
    """

    mean: Tensor
    standardized: Tensor
    p: Tensor

    @property
    def worst(self) -> int | None:
        """Number of the least probable one; None if there is none."""
        if bool(self.p.isnan().all()):
            return None
        least = self.p == self.p[~self.p.isnan()].min()
        return int(torch.where(least, self.standardized.abs(), -1.0).argmax())


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostics of m readings, in the order of messages, then of sensors.

    Attributes:
        residual: reading minus its prediction from all other links, [m], dB; nan if they do not predict it.
        standardized: residual divided by its standard deviation, [m].
        whitened: m - 2 independent standard normal numbers if the model holds, at the most probable fading.
        path_loss: reading minus the path loss fitted to the other links by ordinary least squares, [m], dB.
        links: number of distinct links.
        reading: offset of each reading from all others, repeats of its link included, [m].
        sensor: common offset of each sensor's readings, [N].
        semivariogram: semivariogram of the residuals of path loss.
    """

    residual: Tensor
    standardized: Tensor
    whitened: Tensor
    path_loss: Tensor
    links: int
    reading: Offsets
    sensor: Offsets
    semivariogram: Semivariogram

    @property
    def rmse_dB(self) -> float:
        """Root mean square of `residual`, dB."""
        return _rms(self.residual)

    @property
    def path_loss_rmse_dB(self) -> float:
        """Root mean square of `path_loss`, dB."""
        return _rms(self.path_loss)

    @property
    def rms(self) -> float:
        """Root mean square of `standardized`: about 1 if the model holds."""
        return _rms(self.standardized)

    @property
    def beyond_3(self) -> float:
        """Fraction of readings more than 3 standard deviations off: 0.0027 for normal ones."""
        z = self.standardized[~self.standardized.isnan()]
        return float((z.abs() > 3.0).double().mean())

    @property
    def skewness(self) -> float:
        """Skewness of `whitened`: about 0, with standard deviation sqrt(6 / m)."""
        return self._moment(3)

    @property
    def excess_kurtosis(self) -> float:
        """Excess kurtosis of `whitened`: about 0, with standard deviation sqrt(24 / m)."""
        return self._moment(4) - 3.0

    @property
    def normality_p(self) -> float:
        """p-value of the Jarque-Bera test for normality, valid for many readings."""
        square = self.skewness**2 + 0.25 * self.excess_kurtosis**2
        return math.exp(-len(self.whitened) / 12.0 * square) if math.isfinite(square) else math.nan

    def accused(self, false_alarm: float) -> list[int]:
        """Numbers of the sensors whose offset is too large, most certain first.

        Args:
            false_alarm: probability that any sensor of a log is accused if all are healthy (Bonferroni).
        """
        p = self.sensor.p
        guilty = p * int((~p.isnan()).sum()) < false_alarm
        return [k for k in p.argsort(stable=True).tolist() if guilty[k]]

    def _moment(self, k: int) -> float:
        z = self.whitened - self.whitened.mean()
        return float((z**k).mean() / z.square().mean() ** (k / 2))


def diagnose(readings: Readings, posterior: FadingPosterior) -> Diagnostics:
    """Diagnostics of one data set.

    Args:
        readings: the data set.
        posterior: of its fading, for a coarse grid, because a reading left out may widen it.
    """
    links = posterior.links
    repeats, link, deviation = links.repeats[links.link], links.link, links.deviation[0]
    product, information = posterior.along(torch.eye(len(links.repeats)).to(links.y))
    residual, standardized = _left_out(posterior, product, information)

    # A reading is the mean of its link plus its deviation.
    reading = product[..., link] / repeats + deviation, information[..., link] / repeats.square() + 1.0 - 1.0 / repeats
    receiver = (~readings.snr[0].isnan()).nonzero()[:, 1]
    sensors = torch.zeros(len(links.repeats), len(readings.receivers)).to(links.y)
    sensors[link, receiver] = 1.0

    theta = torch.linalg.lstsq(links.H[link], _observed(links)[:, None], driver="gels").solution[:, 0]
    loss = links.y[0] - links.H @ theta
    leverage = torch.linalg.qr(links.H * links.repeats.sqrt()[:, None]).Q.square().sum(-1)
    without = torch.where(leverage < 1.0 - NOTHING, loss / (1.0 - leverage), torch.nan)
    return Diagnostics(
        residual=residual,
        standardized=standardized,
        whitened=_whitened(posterior),
        path_loss=without[link] + deviation,
        links=len(links.repeats),
        reading=_offsets(posterior, *reading),
        sensor=_offsets(posterior, *posterior.along(sensors)),
        semivariogram=_semivariogram(loss[link] + deviation, posterior),
    )


def _observed(links: Links) -> Tensor:
    return links.y[0, links.link] + links.deviation[0]


def _left_out(posterior: FadingPosterior, product: Tensor, information: Tensor) -> tuple[Tensor, Tensor]:
    """Readings minus their predictions from all other links, [m], in dB and in standard deviations."""
    links, beliefs = posterior.links, posterior.without(product, information)
    offset = product / information
    mean = beliefs.mean(offset)
    # A single reading has more multipath than the mean of its link.
    variance = beliefs.rho2 * (1.0 / information + 1.0 - 1.0 / links.repeats) + (offset - mean[:, None, None]).square()
    residual = mean[0, links.link] + links.deviation[0]
    return residual, residual / beliefs.mean(variance)[0, links.link].sqrt()


def _offsets(posterior: FadingPosterior, product: Tensor, information: Tensor) -> Offsets:
    beliefs, offset = posterior.without(product, information), product / information
    mean = beliefs.mean(offset)
    variance = beliefs.rho2 / information + (offset - mean[:, None, None]).square()
    p = beliefs.beyond(offset * (information / beliefs.scale).sqrt())
    return Offsets(mean[0], (mean / beliefs.mean(variance).sqrt())[0], p[0])


def _whitened(posterior: FadingPosterior) -> Tensor:
    """[m - 2], at the most probable fading: L - 2 numbers from the links' means, m - L from the repeats."""
    links, beliefs = posterior.links, posterior.beliefs
    p, g = divmod(int(beliefs.weight.argmax()), len(posterior.log_ratio))
    axes, rho = posterior.axes[p], beliefs.scale[0, p, g, 0].sqrt()
    root = axes.precision(posterior.log_ratio[g : g + 1].exp())[0].sqrt()
    # In the L - 2 directions orthogonal to path loss, the whitened means are independent.
    reflectors = torch.geqrf(root[:, None] * axes.H)
    between = torch.ormqr(*reflectors, (root * axes.y[0])[:, None], transpose=True)[2:, 0]
    # Each repeat against the mean of those before it.
    order = links.link.argsort(stable=True)
    deviation, link = links.deviation[0, order], links.link[order]
    before = torch.arange(len(link)).to(link) - (links.repeats.cumsum(0) - links.repeats).to(link)[link]
    again = before > 0
    earlier = (deviation.cumsum(0) - deviation)[again] / before[again]
    within = (deviation[again] - earlier) * (before / (before + 1.0))[again].sqrt()
    return torch.cat([between, within]) / rho


def _semivariogram(residual: Tensor, posterior: FadingPosterior) -> Semivariogram:
    links = posterior.links
    apart = links.apart(links.first, links.second)[links.link[:, None], links.link]
    i, j = torch.triu_indices(len(residual), len(residual), 1, device=residual.device)
    d, half_square = apart[i, j], 0.5 * (residual[i] - residual[j]).square()
    bins = (d / (REACH * d.max()).clamp_min(1e-300) * BINS).long().clamp_max(BINS)
    pairs, total, sums = (d.new_zeros(BINS + 1).index_add(0, bins, x) for x in (torch.ones_like(d), d, half_square))
    filled = (pairs > 0) & (torch.arange(BINS + 1, device=d.device) < BINS)
    pairs, distance = pairs[filled], total[filled] / pairs[filled]
    return Semivariogram(distance, sums[filled] / pairs, posterior.semivariance(distance), pairs)


def _rms(values: Tensor) -> float:
    return float(values[~values.isnan()].square().mean().sqrt())
