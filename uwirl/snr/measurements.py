"""SNR readings that sensors send back to a vehicle (eqs 9-10)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.random import Stream
from uwirl.world.relay import Relay


class Readings(NamedTuple):
    """One snapshot: every sensor's SNR reading of one vehicle's initiator message.

    Attributes:
        distance: vehicle to sensor, [N], m.
        snr: readings Y, [N], dB.
    """

    distance: Tensor
    snr: Tensor


def take_readings(env: Relay, world: int = 0, vehicle: int = 0) -> Readings:
    """Readings at the vehicle's start: mean SNR (6) plus multipath, drawn anew for each reading, Gaussian in dB.

    Args:
        env: holds the true channel, the sensors and the random numbers.
        world: whose noise to draw.
        vehicle: who asks.
    """
    sensors = env.scenario.sensors.to(torch.float64)
    position = env.scenario.start[vehicle, :3].to(torch.float64)
    distance = torch.linalg.vector_norm(sensors - position, dim=-1)
    multipath = env.streams.normal(Stream.MEASUREMENT, vehicle, len(sensors))[world]
    return Readings(distance, env.channel.mean_snr_dB(distance) + env.channel.rho_dB * multipath)
