"""Navigation errors of a vehicle: noise of its instruments, and a drifting position.

Without position fixes a vehicle integrates its velocity. A small constant velocity error, for example of a Doppler log,
then becomes a position error that grows with time.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.geometry import vector
from uwirl.world.random import RandomStreams, Stream


@dataclass(frozen=True)
class Navigation:
    """Standard deviations of the errors; if all are zero, the vehicle knows its pose exactly.

    Attributes:
        position_m: of each reading of x, y, z, m.
        yaw_rad: of each reading of psi, rad.
        velocity_mps: of each reading of u, v, w, m/s.
        yaw_rate_rad_s: of each reading of r, rad/s.
        drift_mps: of the velocity at which the horizontal position drifts away, constant over a mission, m/s.
    """

    position_m: float = 0.0
    yaw_rad: float = 0.0
    velocity_mps: float = 0.0
    yaw_rate_rad_s: float = 0.0
    drift_mps: float = 0.0

    @property
    def is_exact(self) -> bool:
        """Whether a vehicle knows its pose and velocity exactly."""
        return not any((self.position_m, self.yaw_rad, self.velocity_mps, self.yaw_rate_rad_s, self.drift_mps))

    def error(self, streams: RandomStreams, step: Tensor, dt: float, vehicles: int) -> Tensor:
        """Error added to the true (eta, nu), [B, M, 8], a pure function of world and step.

        Args:
            streams: B worlds.
            step: int64 [B].
            dt: duration of a step, s.
            vehicles: M.
        """
        stds = [*[self.position_m] * 3, self.yaw_rad, *[self.velocity_mps] * 3, self.yaw_rate_rad_s]
        # Offset by 1, because the random numbers of step 0 give the drift.
        noise = streams.normal(Stream.NAVIGATION, 1 + step, 8 * vehicles).view(-1, vehicles, 8)
        noise = vector(stds, noise) * noise
        drift = self.drift_mps * streams.normal(Stream.NAVIGATION, 0, 2 * vehicles).view(-1, vehicles, 2)
        return noise + torch.nn.functional.pad(drift * (step.double() * dt)[:, None, None], (0, 6))
