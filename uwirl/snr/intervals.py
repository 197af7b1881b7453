"""95 % intervals of an estimate: Student's t for K and n, a logarithmic scale for the fading."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from uwirl.snr.estimate import ChannelEstimate

# Nodes of the integral, whose error is their number's inverse square.
NODES = 200_001


def student_t(coverage: float, freedom: int) -> float:
    """The t with P(|T| < t) = coverage.

    With t = sqrt(v) tan(a) the density is proportional to cos(a)^(v - 1).

    Args:
        coverage: between 0 and 1.
        freedom: v, degrees of freedom.
    """
    # Beyond this angle nothing is left of the density.
    end = min(0.5 * math.pi, 40.0 / math.sqrt(freedom))
    angle = torch.linspace(0.0, end, NODES, dtype=torch.float64)
    mass = torch.cumulative_trapezoid(torch.cos(angle).clamp_min(0.0) ** (freedom - 1), angle)
    k = int(torch.searchsorted(mass, coverage * mass[-1]))
    below = float(mass[k - 1]) if k else 0.0
    share = (coverage * float(mass[-1]) - below) / (float(mass[k]) - below)
    return math.sqrt(freedom) * math.tan(float(angle[k]) + share * float(angle[k + 1] - angle[k]))


def intervals(estimate: ChannelEstimate, readings: int, coverage: float = 0.95) -> Tensor:
    """Lower and upper ends for each parameter of NAMES, [B, 5, 2].

    Args:
        estimate: of B data sets.
        readings: of which each was made, at least 3.
        coverage: between 0 and 1.
    """
    std = estimate.covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    theta = student_t(coverage, readings - 2) * std[:, :2]
    ratio = torch.exp(student_t(coverage, 10**6) * std[:, 2:])
    lower = torch.cat([estimate.value[:, :2] - theta, estimate.value[:, 2:] / ratio], -1)
    upper = torch.cat([estimate.value[:, :2] + theta, estimate.value[:, 2:] * ratio], -1)
    return torch.stack([lower, upper], -1)
