"""Rejection of outliers: single readings, and sensors with wrong readings.

Both are compared with the repeated median line (A. F. Siegel: "Robust regression using repeated medians", Biometrika
69(1), 242-244, 1982), which tolerates almost 50 % wrong readings.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from uwirl.world.acoustics import LinkBudget
from uwirl.world.readings import Readings

# Readings and sensors beyond this many robust standard deviations are rejected; the limit is higher for few values.
CUT, FEW = 4.0, 5.0
# Partners of each reading: more would not improve the line, and would need memory.
PARTNERS = 1000
# A sensor is judged only if it has this many readings, and if there are this many such sensors.
LEAST = 3
# Smaller scales are rounding errors, dB.
ROUNDOFF_DB = 1e-6


def repeated_median(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Slope and intercept of y [n] over x [n]."""
    partner = torch.linspace(0, len(x) - 1, min(len(x), PARTNERS), device=x.device).round().long()
    run = x[:, None] - x[partner]
    slopes = torch.where(run.abs() > 1e-9, (y[:, None] - y[partner]) / run, torch.nan)
    slope = slopes.nanmedian(-1).values.nanmedian()
    return slope, (y - slope * x).median()


def unlike(values: Tensor) -> Tensor:
    """Which of the values [n] are outliers, bool; nan is not an outlier."""
    count = int((~values.isnan()).sum())
    deviation = (values - values.nanmedian()).abs()
    scale = (1.4826 * deviation.nanmedian()).clamp_min(ROUNDOFF_DB)
    return deviation > CUT * (1.0 + FEW / max(count, 1)) * scale


def reject_outliers(readings: Readings, budget: LinkBudget) -> Readings:
    """The same readings, with nan in place of rejected ones."""
    distance = readings.distance
    log_distance = -10.0 * torch.log10(distance)
    kept = []
    for data in readings.snr + budget.known_loss_dB(distance):
        heard = ~data.isnan()
        slope, intercept = repeated_median(log_distance[heard], data[heard])
        residual = data - slope * log_distance - intercept
        refused = unlike(residual.flatten()).view_as(heard)
        often = heard.sum(0) >= LEAST
        if int(often.sum()) >= LEAST:
            typical = torch.where(often, residual.nanmedian(0).values, torch.nan)
            refused |= unlike(typical)
        kept.append(torch.where(refused, torch.nan, data))
    return replace(readings, snr=torch.stack(kept) - budget.known_loss_dB(distance))
