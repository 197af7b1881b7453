"""The avoidance term E_O of the cost (34), (35), and Remark 2's choice of its constants."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

# From distances l [..., O] to the axes, and influence radii rho_o that broadcast, to E_O [...].
Avoidance = Callable[[Tensor, Tensor], Tensor]


def smooth(l: Tensor, influence: Tensor) -> Tensor:
    """cost=relay: sum of max(0, 1/l - 1/rho_o)^2, continuously differentiable, and zero for l > rho_o.

    Args:
        l: distances to the axes, [..., O], m; infinite where there is no obstacle.
        influence: rho_o, m.

    Returns:
        [...], 1/m^2.
    """
    return (1.0 / l - 1.0 / influence).clamp_min(0.0).square().sum(-1)


@dataclass(frozen=True)
class Printed:
    """cost=paper: sum of exp(-(l^2/nu^2)^c / 2) (1/l - 1/rho_o)^2, as (34) and (35) have it.

    Without the max, the bracket grows again for l > rho_o. Unless nu is slightly larger than rho_o, the term then
    attracts vehicles to the ring l = rho_o, where it is zero. It is finite at contact, so vehicles cross an obstacle
    if the link gains more than that.

    Attributes:
        c: steepness.
        nu: range of the repulsion, m.
    """

    c: float
    nu: float

    def __call__(self, l: Tensor, influence: Tensor) -> Tensor:
        cut = torch.exp(-0.5 * (l / self.nu) ** (2.0 * self.c))
        return (cut * (1.0 / l - 1.0 / influence).square()).sum(-1)


def remark_2(left_m: float, right_m: float, kappa_1: float, kappa_2: float) -> tuple[float, float]:
    """c and nu for which f(l) = exp(-(l^2/nu^2)^c / 2) is kappa_1 at l_left and kappa_2 at l_right.

    Remark 2 prints c = ln(log_kappa1 kappa_2) / (2 ln l_right - ln l_left); the 2 must multiply the whole difference.

    Args:
        left_m: slightly smaller than rho_o, m.
        right_m: slightly larger than rho_o, m.
        kappa_1, kappa_2: 0 < kappa_2 < kappa_1 < 1.

    Raises:
        ValueError: the values are not in this order.
    """
    if not 0.0 < left_m < right_m or not 0.0 < kappa_2 < kappa_1 < 1.0:
        raise ValueError(
            f"needs 0 < left < right and 0 < kappa_2 < kappa_1 < 1, got {left_m}, {right_m}, {kappa_1}, {kappa_2}"
        )
    c = math.log(math.log(kappa_2) / math.log(kappa_1)) / (2.0 * (math.log(right_m) - math.log(left_m)))
    return c, left_m / math.exp(math.log(-2.0 * math.log(kappa_1)) / (2.0 * c))
