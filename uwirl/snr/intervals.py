"""95 % intervals of an estimate: Student's t for K and n, a logarithmic scale for the fading."""

from __future__ import annotations

import torch
from scipy import special
from torch import Tensor

from uwirl.snr.estimate import ChannelEstimate


def intervals(estimate: ChannelEstimate, readings: int, coverage: float = 0.95) -> Tensor:
    """Lower and upper ends for each parameter of NAMES, [B, 5, 2].

    Args:
        estimate: of B data sets.
        readings: of which each was made, at least 3.
        coverage: between 0 and 1.
    """
    std = estimate.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    quantile = 0.5 * (1.0 + coverage)
    theta = special.stdtrit(readings - 2, quantile) * std[:, :2]
    ratio = torch.exp(special.ndtri(quantile) * std[:, 2:])
    lower = torch.cat([estimate.value[:, :2] - theta, estimate.value[:, 2:] / ratio], -1)
    upper = torch.cat([estimate.value[:, :2] + theta, estimate.value[:, 2:] * ratio], -1)
    return torch.stack([lower, upper], -1)
