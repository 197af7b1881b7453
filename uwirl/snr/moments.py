"""Fading by the method of moments: the empirical covariance of residuals against distance, as in [29]."""

from __future__ import annotations

import torch
from torch import Tensor

from uwirl.snr.likelihood import grid
from uwirl.snr.model import NOISELESS, Fading, Geometry

BINS, VARPHIS = 20, 200
# Pairs farther apart than the fraction REACH of the span contain little information on the correlation distance; but at
# least the fraction NEAREST of all pairs is used.
REACH, NEAREST = 0.17, 0.1


def moment_fit(residual: Tensor, geometry: Geometry) -> Fading:
    """Fit zeta^2 exp(-d / varphi) to binned covariances by weighted least squares; rho^2 is the rest of the power.

    Only pairs of readings that share an end are used.

    Args:
        residual: from ordinary or generalized least squares, [B, S, N], dB.
        geometry: positions of the readings.

    Returns:
        Fading, [B] each; zeta^2 and rho^2 are at least 1e-4 of the power.
    """
    S, N = residual.shape[1:]
    power = (residual.square().sum((-2, -1)) / (S * N - 2)).clamp_min(NOISELESS)
    pairs = [
        (residual.mT @ residual / S, geometry.spacing, S),
        (residual @ residual.mT / N, geometry.apart, N),
    ]
    products, distance, count = [], [], []
    for product, D, shared in pairs:
        i, j = torch.triu_indices(len(D), len(D), 1, device=D.device)
        products.append(product[:, i, j])
        distance.append(D[i, j])
        count.append(torch.full_like(D[i, j], float(shared)))
    d, n = torch.cat(distance), torch.cat(count)
    reach = max(REACH * geometry.span, float(d.quantile(NEAREST)) * (1.0 + 1e-9))
    bins = (d / reach * BINS).long().clamp_max(BINS)
    per_bin = torch.zeros(BINS + 1, dtype=d.dtype, device=d.device).index_add(0, bins, n)
    filled = (per_bin > 0.0) & (torch.arange(BINS + 1, device=d.device) < BINS)
    sums = residual.new_zeros(len(residual), BINS + 1).index_add(1, bins, torch.cat(products, 1) * n)
    centre = torch.zeros_like(per_bin).index_add(0, bins, n * d)[filled] / per_bin[filled]
    weight, covariance = per_bin[filled], sums[:, filled] / per_bin[filled]
    log_varphi = grid(geometry)[0]
    varphi = torch.linspace(float(log_varphi[0]), float(log_varphi[-1]), VARPHIS, dtype=d.dtype, device=d.device).exp()
    shape = torch.exp(-centre / varphi[:, None])
    # The best zeta^2 for each varphi, at most the total power.
    best = (covariance @ (weight * shape).mT) / (weight * shape.square()).sum(-1)
    best = torch.minimum(best.clamp_min(0.0), power[:, None])
    cost = (weight * (covariance[:, None] - best[..., None] * shape).square()).sum(-1)
    k = cost.argmin(-1)
    least = 1e-4 * power
    zeta2 = best.gather(1, k[:, None])[:, 0].clamp_min(least)
    return Fading(zeta2, varphi[k], (power - zeta2).clamp_min(least))
