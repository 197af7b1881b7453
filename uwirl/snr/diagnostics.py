"""Whether readings look as the model (9)-(13) says, judged by what each is off when the others predict it.

With P = Omega^-1 - Omega^-1 H (H' Omega^-1 H)^-1 H' Omega^-1 the readings of a set b are off all others' prediction by

    r_b = (P_bb)^-1 [P (Y + epsilon)]_b,   cov r_b = (P_bb)^-1

(O. Dubrule: "Cross validation of kriging in a unique neighborhood", Mathematical Geology 15, 687-699, 1983). K and n
are fitted without them each time; the fading is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.acoustics import Channel
from uwirl.world.geometry import distances
from uwirl.world.readings import Readings

BINS = 20
# Pairs farther apart than this share of the longest distance are few and all alike.
REACH = 0.5
# Share of a reading's precision below which the others say nothing of it.
NOTHING = 1e-9


class Semivariogram(NamedTuple):
    """Half the mean square difference of residuals against the distance between links, |p - p'| + |q - q'|.

    Attributes:
        distance: mean of each bin, [k], m.
        empirical: [k], dB^2.
        fitted: rho^2 + zeta^2 (1 - exp(-distance / varphi)), [k], dB^2.
        pairs: [k].
    """

    distance: Tensor
    empirical: Tensor
    fitted: Tensor
    pairs: Tensor


@dataclass(frozen=True)
class Diagnostics:
    """Of m readings, in the order of messages, then of sensors; all in dB or without unit.

    Attributes:
        residual: reading less what the others predict, [m], dB; nan where they predict nothing.
        standardized: that over its standard deviation, [m].
        whitened: m - 2 independent standard normal numbers if the model holds.
        path_loss: reading less the path loss that the others give by ordinary least squares, [m], dB.
        sensor_mean: mean residual of each sensor when the other sensors predict it, [N], dB; nan where they do not.
        sensor_standardized: that over its standard deviation, [N].
        semivariogram: of what path loss leaves.
    """

    residual: Tensor
    standardized: Tensor
    whitened: Tensor
    path_loss: Tensor
    sensor_mean: Tensor
    sensor_standardized: Tensor
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
        """Share of readings more than 3 standard deviations off: 0.0027 of normal ones."""
        z = self.standardized[~self.standardized.isnan()]
        return float((z.abs() > 3.0).double().mean())

    @property
    def skewness(self) -> float:
        """Of `whitened`: about 0, with standard deviation sqrt(6 / m)."""
        return self._moment(3)

    @property
    def excess_kurtosis(self) -> float:
        """Of `whitened`: about 0, with standard deviation sqrt(24 / m)."""
        return self._moment(4) - 3.0

    @property
    def normality_p(self) -> float:
        """Probability of moments so far from the normal ones (Jarque and Bera), for many readings."""
        square = self.skewness**2 + 0.25 * self.excess_kurtosis**2
        return math.exp(-len(self.whitened) / 12.0 * square) if math.isfinite(square) else math.nan

    @property
    def worst(self) -> int:
        """Number of the reading that is farthest off."""
        return int(self.standardized.abs().nan_to_num(0.0).argmax())

    @property
    def worst_sensor(self) -> int | None:
        """Number of the sensor that is farthest off; None where no sensor can be predicted by others."""
        z = self.sensor_standardized.abs()
        return None if bool(z.isnan().all()) else int(z.nan_to_num(0.0).argmax())

    def _moment(self, k: int) -> float:
        z = self.whitened - self.whitened.mean()
        return float((z**k).mean() / z.square().mean() ** (k / 2))


def diagnose(readings: Readings, channel: Channel) -> Diagnostics:
    """Judge one data set.

    Args:
        readings: some 3,000 at most, of which the covariance is inverted.
        channel: an estimate's, whose fading counts.

    Raises:
        torch.linalg.LinAlgError: readings of the same link without multipath.
    """
    heard = ~readings.snr[0].isnan()
    transmitter, receiver = heard.nonzero().unbind(-1)
    first, second = readings.transmitters[transmitter], readings.receivers[receiver]
    length = torch.linalg.vector_norm(first - second, dim=-1)
    y = readings.snr[0][heard] + channel.budget.known_loss_dB(length)
    H = torch.stack([torch.ones_like(length), -10.0 * torch.log10(length)], -1)
    zeta2, varphi, rho2 = (torch.as_tensor(x, dtype=y.dtype, device=y.device).reshape(()) for x in _fading(channel))
    apart = distances(first, first) + distances(second, second)
    omega = zeta2 * torch.exp(-apart / varphi)
    omega.diagonal().add_(rho2)
    factor = torch.linalg.cholesky(omega)

    white_H, white_y = (torch.linalg.solve_triangular(factor, x, upper=False) for x in (H, y[:, None]))
    half = torch.linalg.solve_triangular(factor, torch.eye(len(y)).to(y), upper=False)
    # In the m - 2 directions that path loss leaves, the whitened readings are independent.
    reflectors = torch.geqrf(white_H)
    left, whitened = (torch.ormqr(*reflectors, x, transpose=True)[2:] for x in (half, white_y))
    whitened = whitened[:, 0]
    P = left.mT @ left
    Py = left.mT @ whitened
    precision = P.diagonal()
    # Of Omega^-1: what a reading would tell if path loss were known.
    least = NOTHING * half.square().sum(0)
    told = precision > least
    residual = torch.where(told, Py / precision, torch.nan)

    sensors = [_block(P, Py, (receiver == k).nonzero()[:, 0], least) for k in range(len(readings.receivers))]
    mean, standardized = torch.tensor(sensors, dtype=y.dtype).unbind(-1)
    theta = torch.linalg.lstsq(H, y[:, None], driver="gels").solution[:, 0]
    loss = y - H @ theta
    leverage = torch.linalg.qr(H).Q.square().sum(-1)
    return Diagnostics(
        residual=residual,
        standardized=residual * precision.clamp_min(0.0).sqrt(),
        whitened=whitened,
        path_loss=torch.where(leverage < 1.0 - NOTHING, loss / (1.0 - leverage), torch.nan),
        sensor_mean=mean,
        sensor_standardized=standardized,
        semivariogram=_semivariogram(loss, apart, zeta2, varphi, rho2),
    )


def _fading(channel: Channel) -> tuple[float | Tensor, float | Tensor, float | Tensor]:
    return channel.zeta_dB**2, channel.varphi_m, channel.rho_dB**2


def _block(P: Tensor, Py: Tensor, rows: Tensor, least: Tensor) -> tuple[float, float]:
    """Mean residual, dB, of readings that the others predict, and how many standard deviations that is."""
    if not len(rows):
        return math.nan, math.nan
    block = P[rows[:, None], rows]
    eigenvalues, vectors = torch.linalg.eigh(block)
    # Without these readings path loss cannot be told, so that nothing predicts them.
    if float(eigenvalues[0]) < float(least[rows].min()):
        return math.nan, math.nan
    share = vectors.mT @ P.new_full((len(rows),), 1.0 / len(rows))
    mean = float((share / eigenvalues) @ (vectors.mT @ Py[rows]))
    return mean, mean / math.sqrt(float((share.square() / eigenvalues).sum()))


def _semivariogram(residual: Tensor, apart: Tensor, zeta2: Tensor, varphi: Tensor, rho2: Tensor) -> Semivariogram:
    i, j = torch.triu_indices(len(residual), len(residual), 1)
    d, half_square = apart[i, j], 0.5 * (residual[i] - residual[j]).square()
    bins = (d / (REACH * d.max()).clamp_min(1e-300) * BINS).long().clamp_max(BINS)
    pairs, total, sums = (
        torch.zeros(BINS + 1, dtype=d.dtype).index_add(0, bins, x) for x in (torch.ones_like(d), d, half_square)
    )
    filled = (pairs > 0) & (torch.arange(BINS + 1) < BINS)
    pairs, distance = pairs[filled], total[filled] / pairs[filled]
    fitted = rho2 - zeta2 * torch.expm1(-distance / varphi)
    return Semivariogram(distance, sums[filled] / pairs, fitted, pairs)


def _rms(values: Tensor) -> float:
    return float(values[~values.isnan()].square().mean().sqrt())
