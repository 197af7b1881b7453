"""Ocean current: a constant plus a Gauss-Markov process in each horizontal component.

The covariance of a component at two times is std^2 exp(-|t - t'| / T), the first-order Gauss-Markov process of Fossen
(Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 10.3). It is drawn as a spectral sum,

    sum_k sqrt(2 / K) std cos(omega_k t + phi_k)

where phi_k is uniform and omega_k Cauchy with scale 1/T, whose characteristic function is exp(-|t| / T). The
current is then a pure function of (seed, world, time): it can be evaluated at any time, in any order, and a resumed run
needs no state.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from uwirl.world.random import RandomStreams, Stream

COSINES = 64

CurrentField = Callable[[float | Tensor], Tensor]


@dataclass(frozen=True)
class Current:
    """The current of B worlds, uniform in space.

    Attributes:
        mean: in the inertial frame, [3] or [B, 3], m/s.
        std: standard deviation of each horizontal component about it, m/s.
        time_constant: T, s.
    """

    mean: Tensor
    std: float
    time_constant: float

    @classmethod
    def still(cls, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> Current:
        """No current."""
        return cls(torch.zeros(3, dtype=dtype, device=device), 0.0, math.inf)

    @property
    def is_still(self) -> bool:
        """Whether the current is zero in every world at all times."""
        return self.std == 0.0 and not bool(self.mean.any())

    def worlds(self, index: Tensor) -> Current:
        """The current of some worlds of a batch, by their numbers [K]."""
        return self if self.mean.ndim == 1 else Current(self.mean[index], self.std, self.time_constant)

    def realise(self, streams: RandomStreams) -> CurrentField:
        """The current of each world as a function of time.

        Args:
            streams: B worlds.

        Returns:
            A function of time in s, a number or a tensor that broadcasts against [B]. Its value is the velocity of the
            water in the inertial frame, [..., B, 3], m/s.
        """
        worlds = len(streams.seed)
        mean = self.mean.expand(worlds, 3)
        if self.std == 0.0:
            return partial(_steady, mean=mean)
        draws = streams.uniform(Stream.DISTURBANCE, 0, 4 * COSINES).view(worlds, 2, 2, COSINES)
        # One frequency from each of K equally likely bands: every world then has the whole spectrum, and each
        # omega_k taken at random is still Cauchy.
        quantile = (torch.arange(COSINES, device=draws.device) + draws[:, 0]) / COSINES
        omega = torch.tan(math.pi * (quantile - 0.5)) / self.time_constant
        phase = 2.0 * math.pi * draws[:, 1]
        amplitude = self.std * math.sqrt(2.0 / COSINES)
        return partial(_gusts, mean=mean, omega=omega, phase=phase, amplitude=amplitude)


def _steady(time: float | Tensor, mean: Tensor) -> Tensor:
    shape = time.shape if isinstance(time, Tensor) else ()
    return mean.expand(*torch.broadcast_shapes(shape, mean.shape[:1]), 3)


def _gusts(time: float | Tensor, mean: Tensor, omega: Tensor, phase: Tensor, amplitude: float) -> Tensor:
    time = torch.as_tensor(time, dtype=omega.dtype, device=omega.device)
    horizontal = amplitude * torch.cos(omega * time[..., None, None] + phase).sum(-1)
    return mean + torch.nn.functional.pad(horizontal, (0, 1)).to(mean.dtype)
