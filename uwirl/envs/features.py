"""What a learner from elsewhere is told: an observation as numbers of order one."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.link_frame import LinkFrame
from uwirl.world.geometry import turned_to_body
from uwirl.world.observation import Observation
from uwirl.world.scenario import Scenario

# Beyond this, entries are clipped.
LIMIT = 2.0
# What 1 stands for: about as fast as a BlueROV2 goes, and a strong link.
SPEED_MPS, YAW_RATE_RAD_S, SNR_DB = 2.0, 4.0, 20.0
# Clearance at which an obstacle is as good as absent, m.
FAR_M = 20.0

POSE = ("e_par", "e_perp", "e_z", "sin_yaw", "cos_yaw", "u", "v", "w", "r")
OBSTACLE = ("x", "y", "clearance")
LINKS = ("snr_previous", "snr_next")
NEIGHBOUR = ("x", "y", "z", "x_to_go", "y_to_go", "z_to_go", "heard")


@dataclass(frozen=True)
class Features:
    """F numbers for each vehicle; `names` says which, docs/environments.md what they mean.

    Each is divided by a length, speed or level of the size that it commonly has and clipped at LIMIT.

    Attributes:
        scenario: nodes, depth, hearing range, vehicle radius.
        frame: of each vehicle's target, M + 1 equal hops between the nodes, which every vehicle knows.
        obstacles: how many of those detected are listed, nearest first.
    """

    scenario: Scenario
    frame: LinkFrame
    obstacles: int

    @property
    def names(self) -> tuple[str, ...]:
        """Of the F entries."""
        listed = (f"obstacle_{k + 1}_{name}" for k in range(self.obstacles) for name in OBSTACLE)
        neighbours = (f"{side}_{name}" for side in ("previous", "next") for name in NEIGHBOUR)
        return (*POSE, *listed, *LINKS, *neighbours)

    @property
    def half_span(self) -> float:
        """Half the distance between source and destination, m."""
        return 0.5 * float(torch.linalg.vector_norm(self.scenario.destination - self.scenario.source))

    def __call__(self, observation: Observation, snr: Tensor) -> Tensor:
        """[B, M, F], float32, a new tensor.

        Args:
            observation: of B worlds.
            snr: what each vehicle has read last from the side of the source and of the destination, [B, M, 2], dB; nan
                where it has heard nothing.
        """
        links = torch.nan_to_num(snr / SNR_DB, nan=-LIMIT)
        parts = [self._pose(observation), self._nearest(observation), links, self._neighbours(observation)]
        return torch.cat([part.float() for part in parts], -1).clamp_(-LIMIT, LIMIT)

    def _pose(self, observation: Observation) -> Tensor:
        along, across, up, yaw, u, v, w, r = self.frame.relative(observation).unbind(-1)
        place = along / self.half_span, across / self.half_span, up / (0.5 * self.scenario.depth)
        speed = u / SPEED_MPS, v / SPEED_MPS, w / SPEED_MPS, r / YAW_RATE_RAD_S
        return torch.stack([*place, torch.sin(yaw), torch.cos(yaw), *speed], -1)

    def _nearest(self, observation: Observation) -> Tensor:
        """Offset in body axes and clearance of the nearest obstacles, [B, M, 3 k]; (0, 0, 1) where there is none."""
        known, (B, M) = observation.obstacles, observation.eta.shape[:2]
        away = known.offset(observation.position[..., None, :], observation.time[:, None])[..., 0, :, :]
        # Several times as fast as a norm over an axis of two.
        distance = torch.hypot(away[..., 0], away[..., 1])
        clearance = distance - known.radius - self.scenario.vehicle_radius
        clearance = clearance.masked_fill(~known.present | (clearance > FAR_M), FAR_M)
        offset = turned_to_body(-away, observation.eta[..., 3, None])
        listed = torch.cat([offset, clearance[..., None]], -1) / FAR_M
        listed = torch.where(clearance[..., None] < FAR_M, listed, listed.new_tensor([0.0, 0.0, 1.0]))
        if known.number > 1:
            order = clearance.argsort(dim=-1, stable=True)[..., : self.obstacles]
            listed = listed.gather(-2, order[..., None].expand(*order.shape, 3))
        none = listed.new_tensor([0.0, 0.0, 1.0]).expand(B, M, max(0, self.obstacles - known.number), 3)
        return torch.cat([listed[..., : self.obstacles, :], none], -2).flatten(-2)

    def _neighbours(self, observation: Observation) -> Tensor:
        """What the vehicles before and after each in the chain have told it, [B, M, 14]; zeros where nobody has."""
        B, M = observation.eta.shape[:2]
        if M == 1:
            return observation.eta.new_zeros(B, M, 2 * len(NEIGHBOUR))
        place, target = observation.messages.eta[..., :3], observation.messages.target
        told = []
        for side in (-1, 1):
            theirs, goal = _of_neighbour(place, side), _of_neighbour(target, side)
            offset = theirs - observation.position
            heard = torch.linalg.vector_norm(offset, dim=-1, keepdim=True) <= self.scenario.hearing_range
            ways = [turned_to_body(way, observation.eta[..., 3]) for way in (offset, goal - theirs)]
            entries = torch.cat([way / self.half_span for way in ways] + [torch.ones_like(offset[..., :1])], -1)
            there = torch.arange(M, device=offset.device) + side
            heard = heard & ((there >= 0) & (there < M))[:, None]
            told.append(torch.where(heard, entries, 0.0))
        return torch.cat(told, -1)


def _of_neighbour(told: Tensor, side: int) -> Tensor:
    """What each vehicle has been told by the one before (-1) or after it (1), [B, M, k], of told [B, M, M, k].

    Whoever stands at the end of the chain gets zeros.
    """
    values = told.diagonal(side, 1, 2).movedim(-1, 1)
    return torch.nn.functional.pad(values, (0, 0, 1, 0) if side < 0 else (0, 0, 0, 1))
