"""Random draws for exploration: the excitation added to the policy's control, and the virtual link of a leg."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.motion.link_frame import LinkFrame
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.relay import Relay
from uwirl.world.scenario import Scenario

FREQUENCIES = 6
# Half width of the angle between a link in the arena and the line from its target to the vehicle, rad: in missions,
# vehicles come mostly along the link, too.
ASKEW = 0.4


@dataclass(frozen=True)
class Excitation:
    """Multisine added to the policy's control while learning.

    Attributes:
        rms: root mean square on each axis at full strength, N, N, N, N m.
        strength: range from which the strength of each leg is drawn.
        band_rad_s: range from which the frequencies are drawn, rad/s.
    """

    rms: Sequence[float]
    strength: Sequence[float]
    band_rad_s: Sequence[float]

    def draw(self, streams: RandomStreams, vehicles: int, leg: int, steps: int, dt: float) -> Tensor:
        """The excitation at n steps, [n, B M, 4]."""
        numbers = 1 + 8 * FREQUENCIES
        u = streams.uniform(Stream.EXPLORATION, leg, vehicles * numbers).view(-1, numbers)
        omega, phase = u[:, 1:].view(-1, 2, 4, FREQUENCIES).unbind(1)
        omega = self.band_rad_s[0] + (self.band_rad_s[1] - self.band_rad_s[0]) * omega
        strength = self.strength[0] + (self.strength[1] - self.strength[0]) * u[:, :1]
        time = torch.arange(steps, dtype=u.dtype, device=u.device).view(-1, 1, 1, 1) * dt
        wave = torch.sin(omega * time + 2.0 * math.pi * phase).sum(-1) / (FREQUENCIES / 2.0) ** 0.5
        return wave * strength * torch.tensor(list(self.rms), dtype=u.dtype, device=u.device)


@dataclass(frozen=True)
class PoseDraw:
    """Distribution of the start pose of a leg, relative to its virtual link.

    Attributes:
        along_m, across_m, up_m: half widths of e_par, e_perp and e_z, numbers or [B] where worlds differ.
        yaw_rad: half width of psi~.
        near_share: fraction of legs that start close to the target.
        near_scale: factor of their half widths along and across the link (twice this factor for e_z).
    """

    along_m: float | Tensor
    across_m: float | Tensor
    up_m: float | Tensor
    yaw_rad: float
    near_share: float
    near_scale: float

    def draw(self, streams: RandomStreams, vehicles: int, step: int) -> Tensor:
        """Poses (e_par, e_perp, e_z, psi~), [B M, 4]."""
        u = streams.uniform(Stream.INITIAL_STATE, step, 5 * vehicles).view(-1, 5)
        near = u[:, 4:] < self.near_share
        plane = torch.where(near, self.near_scale, 1.0)
        up = torch.where(near, 2.0 * self.near_scale, 1.0)
        shrink = torch.cat([plane, plane, up, torch.ones_like(up)], -1)
        widths = self.along_m, self.across_m, self.up_m, self.yaw_rad
        half = torch.stack(
            torch.broadcast_tensors(*(torch.as_tensor(x, dtype=u.dtype, device=u.device) for x in widths)), -1
        )
        half = half.repeat_interleave(vehicles, 0) if half.ndim == 2 else half
        return (2.0 * u[:, :4] - 1.0) * half * shrink

    def frame(self, env: Relay, eta: Tensor, step: int) -> LinkFrame:
        """Links placed so that vehicles at [B, M, 4] have the drawn poses, with the targets in the water."""
        pose = self.draw(env.streams, eta.shape[1], step).to(eta.dtype)
        return LinkFrame.seen_as(eta, pose.view(eta.shape)).within(env.scenario.depth)


@dataclass(frozen=True)
class ArenaDraw(PoseDraw):
    """Links anywhere in the box that contains nodes, starts and obstacles; near ones close to the vehicle."""

    def frame(self, env: Relay, eta: Tensor, step: int) -> LinkFrame:
        """Links for vehicles at [B, M, 4], with the targets in the water."""
        about = super().frame(env, eta, step)
        B, M = eta.shape[:-1]
        # The first five numbers of each vehicle are used for its pose.
        u = env.streams.uniform(Stream.INITIAL_STATE, step, 8 * M).to(eta.dtype)
        near = u[:, : 5 * M].view(B, M, 5)[..., 4] < self.near_share
        x, y, askew = u[:, 5 * M :].view(B, M, 3).unbind(-1)
        low, high = _box(env.scenario)
        place = low + (high - low) * torch.stack([x, y], -1)
        away = eta[..., :2] - place
        bearing = torch.atan2(away[..., 1], away[..., 0]) + ASKEW * (2.0 * askew - 1.0)
        target = torch.where(near[..., None], about.target, torch.cat([place, about.target[..., 2:]], -1))
        return LinkFrame(target, torch.where(near, about.bearing, bearing))


def _box(scenario: Scenario) -> tuple[Tensor, Tensor]:
    """Horizontal corners of the box that contains nodes, starts and obstacles, [2] each, m."""
    obstacles = scenario.obstacles
    nodes = (scenario.source, scenario.destination, scenario.start, obstacles.centre[obstacles.present])
    places = torch.cat([node[..., :2].reshape(-1, 2) for node in nodes])
    return places.amin(0), places.amax(0)
