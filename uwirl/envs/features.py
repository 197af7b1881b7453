"""Observations for learners of other libraries, as numbers of order one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from uwirl.motion.link_frame import LinkFrame
from uwirl.world.geometry import length, to_body, turned_to_body
from uwirl.world.observation import Observation
from uwirl.world.scenario import Scenario

# Entries are clipped to this magnitude.
LIMIT = 2.0
# Scales, the meaning of the value 1: about the top speed of a BlueROV2, and the SNR of a strong link.
SPEED_MPS, YAW_RATE_RAD_S, SNR_DB = 2.0, 4.0, 20.0
# Obstacles at this clearance or more are treated as absent, m.
FAR_M = 20.0

POSE = ("e_par", "e_perp", "e_z", "sin_yaw", "cos_yaw", "u", "v", "w", "r")
OBSTACLE = ("x", "y", "clearance")
LINKS = ("snr_previous", "snr_next")
NEIGHBOUR = ("x", "y", "z", "x_to_go", "y_to_go", "z_to_go", "heard")


@dataclass(frozen=True)
class Features:
    """F numbers for each vehicle, called `names`; docs/environments.md describes them.

    Each is divided by a typical length, speed or level, and clipped at LIMIT.

    Attributes:
        scenario: nodes, depth, hearing range, vehicle radius.
        frame: link frame of each vehicle's target (M + 1 equal hops between the nodes), which every vehicle knows.
        obstacles: number of detected obstacles that are listed, nearest first.
    """

    scenario: Scenario
    frame: LinkFrame
    obstacles: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the F entries."""
        listed = (f"obstacle_{k + 1}_{name}" for k in range(self.obstacles) for name in OBSTACLE)
        sides = ("previous", "next") if self.scenario.vehicles > 1 else ()
        neighbours = (f"{side}_{name}" for side in sides for name in NEIGHBOUR)
        return (*POSE, *listed, *LINKS, *neighbours)

    @cached_property
    def half_span(self) -> float:
        """Half the distance between source and destination, m."""
        return 0.5 * float(torch.linalg.vector_norm(self.scenario.destination - self.scenario.source))

    def __call__(self, observation: Observation, snr: Tensor) -> Tensor:
        """Features [B, M, F], float32, a new tensor.

        Args:
            observation: observation in B worlds.
            snr: last SNR readings of each vehicle's links towards source and destination, [B, M, 2], dB; nan if it
                received nothing.
        """
        links = torch.nan_to_num(snr / SNR_DB, nan=-LIMIT).unbind(-1)
        rows = [*self._pose(observation), *self._nearest(observation), *links, *self._neighbours(observation)]
        # Entries on the first axis, moved to the last at the end: writing to the last axis takes four times as long.
        return torch.stack([row.float() for row in rows]).clamp_(-LIMIT, LIMIT).movedim(0, -1).contiguous()

    def _pose(self, observation: Observation) -> list[Tensor]:
        # As `frame.relative`, but coordinate by coordinate, for the same reason.
        (x, y, z, psi), (u, v, w, r) = observation.eta.unbind(-1), observation.nu.unbind(-1)
        target, bearing = self.frame
        along, across = to_body(x - target[:, 0], y - target[:, 1], bearing)
        up, yaw = z - target[:, 2], psi - bearing
        place = [along / self.half_span, across / self.half_span, up / (0.5 * self.scenario.depth)]
        speed = [u / SPEED_MPS, v / SPEED_MPS, w / SPEED_MPS, r / YAW_RATE_RAD_S]
        return [*place, torch.sin(yaw), torch.cos(yaw), *speed]

    def _nearest(self, observation: Observation) -> list[Tensor]:
        """Offset in body axes and clearance of the nearest obstacles; (0, 0, 1) where there is none."""
        known, (x, y, _, psi) = observation.obstacles, observation.eta[..., None].unbind(-2)
        time = observation.time.to(x.dtype)[:, None, None]
        dx, dy = (known.centre[..., k] + known.velocity[..., k] * time - at for k, at in enumerate((x, y)))
        clearance = torch.hypot(dx, dy) - (known.radius + self.scenario.vehicle_radius)
        clearance = torch.where(known.present, clearance, torch.inf)
        offset = to_body(dx, dy, psi)
        if known.number > 1:
            clearance, order = clearance.sort(-1)
            offset = offset[0].gather(-1, order), offset[1].gather(-1, order)
        near, nothing = clearance <= FAR_M, torch.zeros_like(psi[..., 0])
        axes = [
            torch.where(near, axis / FAR_M, none)
            for axis, none in zip((*offset, clearance), (0.0, 0.0, 1.0), strict=True)
        ]
        listed = [axis[..., k] for k in range(min(known.number, self.obstacles)) for axis in axes]
        return listed + [nothing, nothing, nothing + 1.0] * max(0, self.obstacles - known.number)

    def _neighbours(self, observation: Observation) -> list[Tensor]:
        """Entries about the previous and the next vehicle in the chain; zeros if there is none within hearing range.

        Empty if there is only one vehicle.
        """
        M, place, target = observation.eta.shape[1], observation.messages.eta[..., :3], observation.messages.target
        if M == 1:
            return []
        entries: list[Tensor] = []
        for side in (-1, 1):
            theirs, goal = _of_neighbour(place, side), _of_neighbour(target, side)
            offset = theirs - observation.position
            there = torch.arange(M, device=offset.device) + side
            heard = length(offset) <= self.scenario.hearing_range
            heard = heard & (there >= 0) & (there < M)
            ways = [turned_to_body(way, observation.eta[..., 3]) / self.half_span for way in (offset, goal - theirs)]
            rows = [*ways[0].unbind(-1), *ways[1].unbind(-1), torch.ones_like(offset[..., 0])]
            entries += [torch.where(heard, row, 0.0) for row in rows]
        return entries


def _of_neighbour(received: Tensor, side: int) -> Tensor:
    """Values received from the previous (-1) or next (1) vehicle, [B, M, k], selected from [B, M, M, k].

    Zeros for vehicles without this neighbour.
    """
    values = received.diagonal(side, 1, 2).movedim(-1, 1)
    return torch.nn.functional.pad(values, (0, 0, 1, 0) if side < 0 else (0, 0, 0, 1))
