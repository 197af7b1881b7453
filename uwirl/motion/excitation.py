"""Random draws of exploration: control added to the policy's, and the pose that a leg starts with."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from uwirl.world.random import RandomStreams, Stream

FREQUENCIES = 6


@dataclass(frozen=True)
class Excitation:
    """Multisine added to the policy's control while learning.

    Attributes:
        rms: root mean square on each axis at full strength, N, N, N, N m.
        strength: range from which each leg's strength is drawn.
        band_rad_s: range from which the frequencies are drawn, rad/s.
    """

    rms: tuple[float, ...]
    strength: tuple[float, float]
    band_rad_s: tuple[float, float]

    def draw(self, streams: RandomStreams, vehicles: int, leg: int, steps: int, dt: float) -> Tensor:
        """[n, B M, 4]."""
        numbers = 1 + 8 * FREQUENCIES
        u = streams.uniform(Stream.EXPLORATION, leg, vehicles * numbers).view(-1, numbers)
        omega, phase = u[:, 1:].view(-1, 2, 4, FREQUENCIES).unbind(1)
        omega = self.band_rad_s[0] + (self.band_rad_s[1] - self.band_rad_s[0]) * omega
        strength = self.strength[0] + (self.strength[1] - self.strength[0]) * u[:, :1]
        time = torch.arange(steps, dtype=u.dtype, device=u.device).view(-1, 1, 1, 1) * dt
        wave = torch.sin(omega * time + 2.0 * math.pi * phase).sum(-1) / (FREQUENCIES / 2.0) ** 0.5
        return wave * strength * torch.tensor(self.rms, dtype=u.dtype, device=u.device)


@dataclass(frozen=True)
class PoseDraw:
    """Distribution of the pose that a leg starts with, relative to its virtual link.

    Attributes:
        along_m, across_m, up_m: half widths of e_par, e_perp and e_z.
        yaw_rad: half width of psi~.
        near_share: share of legs drawn close to the target instead.
        near_scale: by which their widths along and across shrink (that of e_z by its double).
    """

    along_m: float
    across_m: float
    up_m: float
    yaw_rad: float
    near_share: float
    near_scale: float

    def draw(self, streams: RandomStreams, vehicles: int, step: int) -> Tensor:
        """(e_par, e_perp, e_z, psi~), [B M, 4]."""
        u = streams.uniform(Stream.INITIAL_STATE, step, 5 * vehicles).view(-1, 5)
        near = u[:, 4:] < self.near_share
        plane = torch.where(near, self.near_scale, 1.0)
        up = torch.where(near, 2.0 * self.near_scale, 1.0)
        shrink = torch.cat([plane, plane, up, torch.ones_like(up)], -1)
        half = torch.tensor([self.along_m, self.across_m, self.up_m, self.yaw_rad], dtype=u.dtype, device=u.device)
        return (2.0 * u[:, :4] - 1.0) * half * shrink
