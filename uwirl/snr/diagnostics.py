"""Check of the model (9)-(13) by cross validation: each reading is predicted from all others.

With P = Omega^-1 - Omega^-1 H (H' Omega^-1 H)^-1 H' Omega^-1, the prediction errors of the readings of a set b are

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
# Pairs farther apart than this fraction of the longest distance are few, and are not used.
REACH = 0.5
# If P_bb is below this fraction of a reading's precision, the other readings do not predict it.
NOTHING = 1e-9


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


@dataclass(frozen=True)
class Diagnostics:
    """Diagnostics of m readings, in the order of messages, then of sensors.

    Attributes:
        residual: reading minus its prediction from the others, [m], dB; nan if they do not predict it.
        standardized: residual divided by its standard deviation, [m].
        whitened: m - 2 independent standard normal numbers if the model holds.
        path_loss: reading minus the path loss fitted to the others by ordinary least squares, [m], dB.
        sensor_mean: mean residual of each sensor, predicted from the other sensors, [N], dB; nan if not predicted.
        sensor_standardized: sensor_mean divided by its standard deviation, [N].
        semivariogram: semivariogram of the residuals of path loss.
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

    @property
    def worst(self) -> int:
        """Number of the reading with the largest standardized residual."""
        return int(self.standardized.abs().nan_to_num(0.0).argmax())

    @property
    def worst_sensor(self) -> int | None:
        """Number of the sensor with the largest standardized mean; None if no sensor can be predicted from others."""
        z = self.sensor_standardized.abs()
        return None if bool(z.isnan().all()) else int(z.nan_to_num(0.0).argmax())

    def _moment(self, k: int) -> float:
        z = self.whitened - self.whitened.mean()
        return float((z**k).mean() / z.square().mean() ** (k / 2))


def diagnose(readings: Readings, channel: Channel) -> Diagnostics:
    """Diagnostics of one data set.

    Args:
        readings: about 3,000 at most, because their covariance is inverted.
        channel: estimated channel; only its fading is used.

    Raises:
        torch.linalg.LinAlgError: repeated readings of a link, without multipath.
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
    # In the m - 2 directions orthogonal to path loss, the whitened readings are independent.
    reflectors = torch.geqrf(white_H)
    left, whitened = (torch.ormqr(*reflectors, x, transpose=True)[2:] for x in (half, white_y))
    whitened = whitened[:, 0]
    P = left.mT @ left
    Py = left.mT @ whitened
    precision = P.diagonal()
    # Diagonal of Omega^-1: precision of the prediction of a reading if path loss were known.
    least = NOTHING * half.square().sum(0)
    predicted = precision > least
    residual = torch.where(predicted, Py / precision, torch.nan)

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
    """Mean residual, dB, of readings predicted from all others, and the same in standard deviations."""
    if not len(rows):
        return math.nan, math.nan
    block = P[rows[:, None], rows]
    eigenvalues, vectors = torch.linalg.eigh(block)
    # Without these readings path loss is not identifiable, so nothing predicts them.
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
