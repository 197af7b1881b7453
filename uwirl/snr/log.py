"""A log of SNR readings as a CSV file: positions of senders and sensors, and SNR.

    vehicle_x_m, vehicle_y_m, vehicle_z_m, sensor_x_m, sensor_y_m, sensor_z_m, snr_dB   [time_s, vehicle, sensor]

in any order, one row per reading. A blank snr_dB means that nothing was received. Rows with the same vehicle position
and time belong to the same message; a sensor that stands twice in it has heard a further message from the same place.
A sensor is known by its name, or by its position if it has none. One with a name may move.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import torch
from torch import Tensor

from uwirl.snr.log_file import LogError, LogFile, Place, Row, parse
from uwirl.world.readings import Readings

# Largest complete log (each sensor reads each message); other logs need the eigenvectors of all readings.
COMPLETE = 3000
# Steps of a selection over messages and sensors: no combination of them with whole numbers is a whole number, so no
# period of the rows meets another; multiples of the golden ratio fill an interval the most evenly of all.
STEPS = (0.5 * (math.sqrt(5.0) - 1.0), math.sqrt(3.0) - 1.0)
# A named sensor moves with a ship at most, m/s, besides the noise of its positions, m.
FASTEST_MPS, NOISE_M = 20.0, 10.0
# This many rows, and this share of the repeated ones, are no coincidence if they have the same SNR.
COPIES, SHARE = 10, 0.9
# Lines and sensors that are named in a sentence.
LISTED = 5


@dataclass(frozen=True)
class Log:
    """R rows of a file, with readings of S messages at N sensors.

    Attributes:
        transmitters: positions of the senders, in the order of time if given, otherwise of the file, [S, 3], m.
        receivers: positions of the sensors, [N, 3], m; several for one that moves.
        names: names of the sensors, or their positions if they have none, [N]; twice for a sensor that moves.
        message, sensor: numbers for each row, int64 [R].
        snr: [R], dB; nan where nothing was received.
        line: line of the file for each row, int64 [R].
        unused: names of columns that are not used.
        doubts: sentences on what was read but looks wrong.
    """

    transmitters: Tensor
    receivers: Tensor
    names: tuple[str, ...]
    message: Tensor
    sensor: Tensor
    snr: Tensor
    line: Tensor
    unused: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def heard(self) -> int:
        """Number of rows with a reading."""
        return int((~self.snr.isnan()).sum())

    def thinned(self, most: int) -> Log:
        """Rows with readings only; if there are more than `most`, a selection that is even over messages and sensors.

        A log in which all sensors read all messages may have more readings, up to COMPLETE.
        """
        rows = (~self.snr.isnan()).nonzero()[:, 0]
        S, N = (len(which[rows].unique()) for which in (self.message, self.sensor))
        complete = len(rows) == S * N and max(S, N) <= most and len(rows) <= COMPLETE
        if len(rows) > most and not complete:
            known = {name: k for k, name in enumerate(dict.fromkeys(self.names))}
            sensor = torch.tensor([known[name] for name in self.names])[self.sensor]
            # A lattice: any run of messages, and any sensor, has its share of every interval of fractional parts.
            lattice = STEPS[0] * self.message[rows].double() + STEPS[1] * sensor[rows].double()
            rows = rows[lattice.frac().argsort(stable=True)[:most].sort().values]
        messages, message = self.message[rows].unique(return_inverse=True)
        sensors, sensor = self.sensor[rows].unique(return_inverse=True)
        return replace(
            self,
            transmitters=self.transmitters[messages],
            receivers=self.receivers[sensors],
            names=tuple(self.names[k] for k in sensors.tolist()),
            message=message,
            sensor=sensor,
            snr=self.snr[rows],
            line=self.line[rows],
        )

    def table(self, values: Tensor, nothing: float) -> Tensor:
        """Values [R] of the rows, arranged by message and sensor, [S, N]."""
        table = values.new_full((len(self.transmitters), len(self.receivers)), nothing)
        table[self.message, self.sensor] = values
        return table

    @property
    def readings(self) -> Readings:
        """The log as one data set, [1, S, N]."""
        return Readings(self.transmitters, self.receivers, self.table(self.snr, math.nan)[None])


def read_log(path: Path) -> Log:
    """Read and check a file.

    Raises:
        LogError: columns are missing, there is no reading, or a row is invalid.
        OSError: the file cannot be opened.
    """
    file = parse(path)
    rows = file.rows
    if not any(math.isfinite(row.snr) for row in rows):
        raise LogError(path, "holds no reading: every snr_dB is blank" if rows else "holds no rows below its header")
    messages = _messages(rows)
    keys = sorted(dict.fromkeys(messages), key=lambda key: key[1])
    number = {key: k for k, key in enumerate(keys)}
    places = {place: k for k, place in enumerate(dict.fromkeys((row.name, row.sensor) for row in rows))}
    return Log(
        transmitters=torch.tensor([place for place, _, _ in keys], dtype=torch.float64),
        receivers=torch.tensor([place for _, place in places], dtype=torch.float64),
        names=tuple(name or "({:.12g}, {:.12g}, {:.12g})".format(*place) for name, place in places),
        message=torch.tensor([number[key] for key in messages]),
        sensor=torch.tensor([places[row.name, row.sensor] for row in rows]),
        snr=torch.tensor([row.snr for row in rows], dtype=torch.float64),
        line=torch.tensor([row.line for row in rows]),
        unused=file.unused,
        doubts=(*_padding(file.padded), *_copies(file), *_jumps(file)),
    )


def _messages(rows: list[Row]) -> list[tuple[Place, float, int]]:
    """For each row, the sender's position, the time, and how often the sensor has heard that before."""
    heard: Counter[tuple] = Counter()
    keys = []
    for row in rows:
        ends = (row.vehicle, row.time, row.name or row.sensor)
        keys.append((row.vehicle, row.time, heard[ends]))
        heard[ends] += 1
    return keys


def _padding(lines: list[int]) -> Iterator[str]:
    if lines:
        yield f"NUL bytes were skipped on line {_listed(lines)}: did the logger lose power? Look at the rows around"


def _copies(file: LogFile) -> Iterator[str]:
    """Rows with the same time, ends and SNR as another: two pings in one second rarely have the same SNR."""
    if not file.timed:
        return
    repeated = Counter(row._replace(line=0, snr=0.0) for row in file.rows if math.isfinite(row.snr))
    same = Counter(row._replace(line=0) for row in file.rows if math.isfinite(row.snr))
    more, copies = (sum(counts.values()) - len(counts) for counts in (repeated, same))
    if copies >= max(COPIES, SHARE * more):
        yield (
            f"{copies:,} rows are copies of another, SNR included; leave one of each, or standard errors are too small"
        )


def _jumps(file: LogFile) -> Iterator[str]:
    """Named sensors that are moved faster than a ship; without times, much farther than from row to row elsewhere."""
    sensors: dict[str, list[Row]] = {}
    for row in sorted(file.rows, key=lambda row: row.time):
        if row.name:
            sensors.setdefault(row.name, []).append(row)
    jumps = []
    for name, rows in sensors.items():
        steps = [math.dist(first.sensor, second.sensor) for first, second in pairwise(rows)]
        usual = FASTEST_MPS * median(steps) if steps and not file.timed else 0.0
        for (first, second), step in zip(pairwise(rows), steps, strict=True):
            if step > NOISE_M + usual + FASTEST_MPS * (second.time - first.time):
                jumps.append(f"{name!r} moves {step:,.0f} m from line {first.line} to line {second.line}")
                break
    if jumps:
        yield f"sensor {_listed(jumps)}: correct its position, or give each sensor a name of its own"


def _listed(things: list) -> str:
    return ", ".join(map(str, things[:LISTED])) + (", ..." if len(things) > LISTED else "")
