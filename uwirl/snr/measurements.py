"""SNR readings: who heard whom, and how well (eqs 9-10)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from uwirl.world.fading import distances
from uwirl.world.random import Stream
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Readings:
    """What each of N sensors reads of each of S messages; B data sets may have been read at the same places.

    Attributes:
        transmitters: where the messages were sent, [S, 3], m.
        receivers: the sensors, [N, 3], m.
        snr: Y, [B, S, N], dB; nan where nothing was heard.
    """

    transmitters: Tensor
    receivers: Tensor
    snr: Tensor

    @property
    def distance(self) -> Tensor:
        """[S, N], m."""
        return distances(self.transmitters, self.receivers)

    def select(self, rows: Tensor | slice) -> Readings:
        """Some of the data sets."""
        return replace(self, snr=self.snr[rows])


def take_readings(env: Relay, vehicle: int = 0, world: int = 0) -> Readings:
    """Readings from the start of a mission: the messages of one vehicle, of the source and of the destination.

    The vehicle asks, and the sensors within hearing range answer (the set N_i) with what they read of it and, being
    nodes of the same network, of source and destination where they hear those. A reading is mean SNR (6) plus
    shadowing plus multipath, the latter drawn anew for each.

    Args:
        env: holds the true channel, the sensors and the random numbers.
        vehicle: who asks.
        world: which one.

    Returns:
        One data set, [1, 3, N_i].
    """
    scenario, channel = env.scenario, env.channel
    start = scenario.start if scenario.start.ndim == 2 else scenario.start[world]
    transmitters = torch.stack([start[vehicle, :3], scenario.source, scenario.destination]).to(torch.float64)
    sensors = scenario.sensors.to(torch.float64)
    distance = distances(transmitters, sensors)
    ends = transmitters[:, None].expand(-1, len(sensors), -1), sensors.expand(len(transmitters), -1, -1)
    shadowing = env.shadowing(*(end.reshape(1, -1, 3) for end in ends))[world].view_as(distance)
    multipath = env.streams.normal(Stream.MEASUREMENT, vehicle, distance.numel())[world].view_as(distance)
    snr = channel.mean_snr_dB(distance) + shadowing + channel.rho_dB * multipath
    heard = distance <= scenario.hearing_range
    answering = heard[0]
    snr = torch.where(heard, snr, torch.nan)[:, answering]
    return Readings(transmitters, sensors[answering], snr[None])


def readings_of_each_vehicle(env: Relay) -> list[Readings]:
    """Of all vehicles in the first world, before anything moves."""
    return [take_readings(env, vehicle) for vehicle in range(env.scenario.vehicles)]
