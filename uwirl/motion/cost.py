"""The running cost of stage 2 (37), zero at rest at the optimum.

    g = beta_1 (1/C^2 - 1/C_max^2) + beta_2 E_O + yaw_weight (1 - cos psi~)
        + sum_k R_k ((tau_k - tau_trim,k) / tau_max,k)^2

C is the smaller mean capacity of a vehicle's two links, with its neighbours at their targets; C_max is C at the
vehicle's own target.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.avoidance import Avoidance, Printed, remark_2, smooth
from uwirl.world.acoustics import Channel
from uwirl.world.geometry import length
from uwirl.world.obstacles import Obstacles


@dataclass(frozen=True)
class CostWeights:
    """Weights of a mission's running cost; the defaults are those of cost=relay.

    Attributes:
        beta_1: weight of the link cost, (kbit/s)^2.
        beta_2: weight of the avoidance term, m^2.
        yaw_weight: weight of the yaw term; without this small term the optimal yaw control would be zero.
        R: control weights, with efforts normalised by the thruster limits; surge, sway, heave, yaw.
        avoidance: avoidance term E_O.
    """

    beta_1: float = 100.0
    beta_2: float = 1.0
    yaw_weight: float = 0.01
    R: Sequence[float] = (0.1, 0.08, 1.0, 1.2)
    avoidance: Avoidance = smooth


@dataclass(frozen=True)
class PrintedCostWeights(CostWeights):
    """cost=paper: the avoidance term as printed, with Remark 2's constants.

    Attributes:
        left_m, right_m, kappa_1, kappa_2: see `remark_2`.
    """

    left_m: float = 5.9
    right_m: float = 6.5
    kappa_1: float = 0.9
    kappa_2: float = 0.1

    def __post_init__(self) -> None:
        constants = remark_2(self.left_m, self.right_m, self.kappa_1, self.kappa_2)
        object.__setattr__(self, "avoidance", Printed(*constants))


class RelayCost:
    """Running cost in link-frame coordinates.

    Args:
        channel: the estimated channel for learning, the true one for evaluation.
        neighbours: positions of a vehicle's two neighbours in its link frame, [..., M, 2, 3], m.
        weights: weights of the terms.
        tau_max: thruster limits, [4].
    """

    def __init__(self, channel: Channel, neighbours: Tensor, weights: CostWeights, tau_max: Tensor):
        self.channel = channel
        self.neighbours = neighbours
        self.weights = weights
        # With efforts in newtons, 0.16 m/s would be optimal and vehicles would not arrive in time.
        self.R = torch.tensor(list(weights.R), dtype=tau_max.dtype, device=tau_max.device) / tau_max**2
        self.minimum = self._inverse_square_capacity(neighbours.new_zeros(*neighbours.shape[:-2], 3))

    def _inverse_square_capacity(self, error: Tensor) -> Tensor:
        hop = length(error[..., None, :] - self.neighbours).amax(-1)
        return self.weights.beta_1 / self.channel.mean_capacity_kbps(hop).square()

    def link(self, xi: Tensor) -> Tensor:
        """E_L minus its minimum, [..., M], at xi [..., M, 8]."""
        return self._inverse_square_capacity(xi[..., :3]) - self.minimum

    @property
    def scale(self) -> Tensor:
        """E_L minus its minimum for a vehicle at a neighbour's position: the link cost without a relay, [..., M]."""
        return self._inverse_square_capacity(self.neighbours[..., 0, :]) - self.minimum

    def yaw(self, xi: Tensor) -> Tensor:
        """The yaw term, [..., M]."""
        return self.weights.yaw_weight * (1.0 - torch.cos(xi[..., 3]))

    def of(self, vehicle: Tensor) -> RelayCost:
        """The cost of some vehicles, by their numbers [K], counted through all worlds; K becomes the new M."""
        one = copy(self)
        vehicle = vehicle % self.neighbours.shape[-3]
        one.neighbours, one.minimum = self.neighbours[vehicle], self.minimum[vehicle]
        one.channel = self.channel.of(vehicle)
        return one

    def obstacle(self, obstacles: Obstacles, position: Tensor, time: Tensor | float = 0.0) -> Tensor:
        """The avoidance term, [..., M], at [..., M, 3] and a time in s, a number or [...].

        It depends on the position in the world, not only relative to the link, so it is not part of `state`.
        """
        if obstacles.number == 0:
            return torch.zeros_like(position[..., 0])
        l = obstacles.distance(position, time)
        return self.weights.beta_2 * self.weights.avoidance(l, obstacles.influence[..., None, :])

    def state(self, xi: Tensor) -> Tensor:
        """The terms of q that depend on xi only, [..., M]."""
        return self.link(xi) + self.yaw(xi)

    def control(self, effort: Tensor) -> Tensor:
        """Cost of effort = tau - tau_trim [..., M, 4]."""
        return (self.R * effort.square()).sum(-1)
