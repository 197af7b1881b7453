"""95 % intervals of an estimate: Student's t for K and n, a logarithmic scale for the fading."""

from __future__ import annotations

import math

import torch
from scipy import special
from torch import Tensor

from uwirl.snr.estimate import ChannelEstimate


def student_t(coverage: float, freedom: float) -> float:
    """The quantile t of Student's distribution with P(|T| < t) = coverage.

    Args:
        coverage: between 0 and 1.
        freedom: degrees of freedom; infinite for the normal distribution.
    """
    return float(special.stdtrit(freedom, 0.5 * (1.0 + coverage)))


def intervals(estimate: ChannelEstimate, readings: int, coverage: float = 0.95) -> Tensor:
    """Lower and upper ends for each parameter of NAMES, [B, 5, 2].

    Args:
        estimate: estimates from B data sets.
        readings: number of readings in each data set, at least 3.
        coverage: between 0 and 1.
    """
    std = estimate.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    theta = student_t(coverage, readings - 2) * std[:, :2]
    ratio = torch.exp(student_t(coverage, math.inf) * std[:, 2:])
    lower = torch.cat([estimate.value[:, :2] - theta, estimate.value[:, 2:] / ratio], -1)
    upper = torch.cat([estimate.value[:, :2] + theta, estimate.value[:, 2:] * ratio], -1)
    return torch.stack([lower, upper], -1)
