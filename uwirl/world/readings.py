"""SNR readings as estimators get them: senders, receivers and SNR (eqs 9-10)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from uwirl.world.geometry import distances
from uwirl.world.messages import snr_heard, transmitters
from uwirl.world.relay import Relay
from uwirl.world.truth import truth_of


@dataclass(frozen=True)
class Readings:
    """SNR of each of S messages at each of N sensors, for B data sets with the same positions.

    Attributes:
        transmitters: positions of the senders, [S, 3], m.
        receivers: positions of the sensors, [N, 3], m.
        snr: Y, [B, S, N], dB; nan where nothing was received.
    """

    transmitters: Tensor
    receivers: Tensor
    snr: Tensor

    @property
    def distance(self) -> Tensor:
        """Distances of all links, [S, N], m."""
        return distances(self.transmitters, self.receivers)

    def select(self, rows: Tensor | slice) -> Readings:
        """Some of the data sets."""
        return replace(self, snr=self.snr[rows])


def take_readings(env: Relay, vehicle: int = 0, world: int = 0) -> Readings:
    """Readings from the start of a mission, by the sensors that answered: one data set, [1, 3, N_i].

    Args:
        env: the environment.
        vehicle: number of the vehicle whose message the sensors answer.
        world: number of the world.
    """
    one = env.select(torch.tensor([world], device=env.streams.seed.device))
    start = one.scenario.start if one.scenario.start.ndim == 2 else one.scenario.start[0]
    position = start[vehicle, :3]
    snr = snr_heard(one.scenario, truth_of(one), one.streams, position[None], vehicle, 0)
    answering = ~snr[0, 0].isnan()
    sensors = one.scenario.sensors.to(torch.float64)
    return Readings(transmitters(one.scenario, position), sensors[answering], snr[..., answering])


def readings_of_each_vehicle(env: Relay) -> list[Readings]:
    """Readings of all vehicles in the first world, before the mission."""
    return [take_readings(env, vehicle) for vehicle in range(env.scenario.vehicles)]
