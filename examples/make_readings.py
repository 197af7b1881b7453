"""Make readings.csv: what a simulated vehicle and 16 sensors would have written down.

    python examples/make_readings.py

The same seed gives the same file, byte for byte.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import torch
from torch import Tensor

from uwirl import build
from uwirl.config.compose import compose
from uwirl.snr.log_file import OPTIONAL, REQUIRED
from uwirl.world.geometry import distances
from uwirl.world.random import RandomStreams, Stream
from uwirl.world.truth import truth_of

SEED, SENSORS = 7, 16
# A dive from the surface near the destination to beside the source, with stops of two messages 10 s apart.
PLACES, LEG_S, MESSAGES, PERIOD_S = 10, 40.0, 2, 10.0
START, END, SWAY_M = (24.0, 30.0, -1.0), (-22.0, -26.0, -14.0), 12.0
DROPOUT = 0.04


def positions() -> Tensor:
    """Where the vehicle stops, [10, 3], m, to the centimetre."""
    share = torch.linspace(0.0, 1.0, PLACES, dtype=torch.float64)[:, None]
    start, end = torch.tensor([START, END], dtype=torch.float64)
    sway = SWAY_M * torch.sin(2.0 * torch.pi * share) * torch.tensor([1.0, -1.0, 0.0], dtype=torch.float64)
    return (start + share * (end - start) + sway).round(decimals=2)


def text() -> str:
    """The file."""
    config = compose(["channel=acoustic_24khz", f"seed={SEED}", f"scenario.sensors={SENSORS}"])
    env = build.make_relay(config)
    vehicle, sensors = positions().repeat_interleave(MESSAGES, 0), env.scenario.sensors.round(decimals=2)
    distance = distances(vehicle, sensors)
    ends = vehicle[:, None].expand(-1, SENSORS, -1), sensors.expand(len(vehicle), -1, -1)
    truth = truth_of(env)
    shadowing = truth.shadowing(*(end.reshape(1, -1, 3) for end in ends)).view_as(distance)
    streams = RandomStreams.worlds(SEED, 1)
    multipath = streams.normal(Stream.MEASUREMENT, 0, distance.numel()).view_as(distance)
    lost = streams.uniform(Stream.DISTURBANCE, 0, distance.numel()).view_as(distance) < DROPOUT
    snr = truth.channel.mean_snr_dB(distance) + shadowing + truth.channel.rho_dB * multipath
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow((*OPTIONAL, *REQUIRED))
    for s in range(len(vehicle)):
        time = LEG_S * (s // MESSAGES) + PERIOD_S * (s % MESSAGES)
        for j in range(SENSORS):
            places = [f"{x:.2f}" for x in (*vehicle[s].tolist(), *sensors[j].tolist())]
            # A hundredth of a dB is what a modem reports, and more than the last bits of another machine.
            reading = "" if bool(lost[s, j]) else f"{float(snr[s, j]):.2f}"
            writer.writerow((f"{time:g}", "auv", f"buoy-{j + 1:02d}", *places, reading))
    return file.getvalue()


if __name__ == "__main__":
    Path(__file__).with_name("readings.csv").write_text(text())
