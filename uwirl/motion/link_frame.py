"""State of a vehicle relative to its link: the coordinates in which stage 2 learns.

The dynamics do not change under translation and yaw, so a vehicle's problem depends only on its pose relative to its
link:

    xi = [e_par, e_perp, e_z, psi~, u, v, w, r]

e = p - p_d along the link's horizontal bearing t, its horizontal normal o, and up; psi~ = psi - psi_d, psi_d the
bearing.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.geometry import to_body, turned_to_inertial
from uwirl.world.vehicle import Moving


class LinkFrame(NamedTuple):
    """Target and bearing of a link, for each vehicle.

    Attributes:
        target: p_d, [..., M, 3], m.
        bearing: psi_d, [..., M], rad.
    """

    target: Tensor
    bearing: Tensor

    @classmethod
    def seen_as(cls, eta: Tensor, pose: Tensor) -> LinkFrame:
        """The frame in which a vehicle at `eta` [..., M, 4] has the pose (e_par, e_perp, e_z, psi~) [..., M, 4]."""
        bearing = eta[..., 3] - pose[..., 3]
        return cls(eta[..., :3] - turned_to_inertial(pose[..., :3], bearing), bearing)

    def within(self, depth: float) -> LinkFrame:
        """The frame with its target kept at least 1 m, or depth / 20, from surface and floor; depth in m."""
        x, y, z = self.target.unbind(-1)
        low, high = min(-0.95 * depth, 1.0 - depth), max(-0.05 * depth, -1.0)
        return LinkFrame(torch.stack([x, y, z.clamp(low, high)], -1), self.bearing)

    def relative(self, state: Moving) -> Tensor:
        """xi [..., M, 8] for a state [..., M]."""
        x, y, z, psi = state.eta.unbind(-1)
        along, across = to_body(x - self.target[..., 0], y - self.target[..., 1], self.bearing)
        pose = along, across, z - self.target[..., 2], psi - self.bearing
        return torch.stack([*pose, *state.nu.unbind(-1)], -1)


def relabel(xi: Tensor, pose: Tensor) -> Tensor:
    """The same motion in another frame, in which it starts at a given pose.

    Args:
        xi: [n + 1, ..., 8].
        pose: (e_par, e_perp, e_z, psi~) of the first sample in the new frame, [..., 4].

    Returns:
        [n + 1, ..., 8]; velocities are body-fixed and unchanged.
    """
    moved = xi[..., :4] - xi[:1, ..., :4]
    turn = pose[..., 3] - xi[0, ..., 3]
    c, s = torch.cos(turn), torch.sin(turn)
    # Summed in this order, not by `to_inertial`, so that results stay equal to earlier ones to the last bit.
    along = pose[..., 0] + c * moved[..., 0] - s * moved[..., 1]
    across = pose[..., 1] + s * moved[..., 0] + c * moved[..., 1]
    return torch.cat(
        [torch.stack([along, across, pose[..., 2] + moved[..., 2], pose[..., 3] + moved[..., 3]], -1), xi[..., 4:]], -1
    )
