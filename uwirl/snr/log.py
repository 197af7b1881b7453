"""A log of SNR readings as a CSV file: positions of senders and sensors, and SNR.

    vehicle_x_m, vehicle_y_m, vehicle_z_m, sensor_x_m, sensor_y_m, sensor_z_m, snr_dB   [time_s, vehicle, sensor]

in any order, one row per reading. A blank snr_dB means that nothing was received. Rows with the same vehicle position
and time belong to the same message; without times, a repeated pair of ends is a further message from the same place.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.world.readings import Readings

VEHICLE = ("vehicle_x_m", "vehicle_y_m", "vehicle_z_m")
SENSOR = ("sensor_x_m", "sensor_y_m", "sensor_z_m")
REQUIRED = (*VEHICLE, *SENSOR, "snr_dB")
OPTIONAL = ("time_s", "vehicle", "sensor")
# A larger number indicates a mistake in units or columns.
MAX_COORDINATE_M, MAX_SNR_DB = 1e6, 500.0
# Largest complete log (each sensor reads each message); other logs need the eigenvectors of all readings.
COMPLETE = 3000

Place = tuple[float, float, float]


class LogError(ValueError):
    """A log that cannot be used.

    Args:
        path: path of the file.
        problem: what is wrong, and what would be correct.
        line: line of the file, counted from 1.
        column: name of the column.
    """

    def __init__(self, path: Path, problem: str, line: int | None = None, column: str | None = None):
        where = [str(path)] + [f"line {line}"] * (line is not None) + [f"column {column}"] * (column is not None)
        super().__init__(f"{', '.join(where)}: {problem}")


class _Row(NamedTuple):
    line: int
    vehicle: Place
    sensor: Place
    name: str
    time: float | None
    snr: float


@dataclass(frozen=True)
class Log:
    """R rows of a file, with readings of S messages at N sensors.

    Attributes:
        transmitters: positions of the senders, in the order of time if given, otherwise of the file, [S, 3], m.
        receivers: positions of the sensors, [N, 3], m.
        names: names of the sensors, or their positions if they have none, [N].
        message, sensor: numbers for each row, int64 [R].
        snr: [R], dB; nan where nothing was received.
        line: line of the file for each row, int64 [R].
        unused: names of columns that are not used.
    """

    transmitters: Tensor
    receivers: Tensor
    names: tuple[str, ...]
    message: Tensor
    sensor: Tensor
    snr: Tensor
    line: Tensor
    unused: tuple[str, ...] = ()

    @property
    def heard(self) -> int:
        """Number of rows with a reading."""
        return int((~self.snr.isnan()).sum())

    def thinned(self, most: int) -> Log:
        """Rows with readings only; if there are more than `most`, an evenly spaced selection.

        A log in which all sensors read all messages may have more readings, up to COMPLETE.
        """
        rows = (~self.snr.isnan()).nonzero()[:, 0]
        S, N = (len(which[rows].unique()) for which in (self.message, self.sensor))
        complete = len(rows) == S * N and max(S, N) <= most and len(rows) <= COMPLETE
        if len(rows) > most and not complete:
            rows = rows[torch.linspace(0, len(rows) - 1, most, dtype=torch.float64).round().long()]
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
    unused, rows = _parse(path)
    messages = _messages(path, rows)
    sensors = _sensors(path, rows)
    if not any(math.isfinite(row.snr) for row in rows):
        raise LogError(path, "holds no reading: every snr_dB is blank" if rows else "holds no rows below its header")
    # There is only one message from a place at a time, so a key identifies a message.
    keys = list(dict.fromkeys(messages))
    if rows[0].time is not None:
        keys.sort(key=lambda key: key[1])
    number = {key: k for k, key in enumerate(keys)}
    identities = {sensor: k for k, sensor in enumerate(dict.fromkeys(sensors))}
    return Log(
        transmitters=torch.tensor([place for place, _ in keys], dtype=torch.float64),
        receivers=torch.tensor([place for _, place in identities], dtype=torch.float64),
        names=tuple(name or "({:g}, {:g}, {:g})".format(*place) for name, place in identities),
        message=torch.tensor([number[key] for key in messages]),
        sensor=torch.tensor([identities[sensor] for sensor in sensors]),
        snr=torch.tensor([row.snr for row in rows], dtype=torch.float64),
        line=torch.tensor([row.line for row in rows]),
        unused=unused,
    )


def _messages(path: Path, rows: list[_Row]) -> list[tuple[Place, float]]:
    """For each row, the sender's position, and the time, or without times the count of this pair of ends."""
    seen: dict[tuple, int] = {}
    repeated: Counter[tuple] = Counter()
    keys = []
    for row in rows:
        ends = (row.vehicle, row.name, row.sensor)
        if row.time is None:
            repeated[ends] += 1
            keys.append((row.vehicle, float(repeated[ends])))
            continue
        first = seen.setdefault((*ends, row.time), row.line)
        if first != row.line:
            problem = f"the same message at the same sensor as line {first}; keep one of them, or correct time_s"
            raise LogError(path, problem, row.line)
        keys.append((row.vehicle, row.time))
    return keys


def _sensors(path: Path, rows: list[_Row]) -> list[tuple[str, Place]]:
    """For each row, name and position of its sensor."""
    places: dict[str, _Row] = {}
    for row in rows:
        first = places.setdefault(row.name, row)
        if row.name and first.sensor != row.sensor:
            problem = f"{row.name!r} is at {row.sensor}, but on line {first.line} at {first.sensor}"
            raise LogError(path, f"{problem}; give a sensor that was moved another name", row.line, "sensor")
    return [(row.name, row.sensor) for row in rows]


def _parse(path: Path) -> tuple[tuple[str, ...], list[_Row]]:
    """Columns that are not used, and the rows."""
    try:
        # Spreadsheets begin a file with a byte order mark.
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            _check_header(path, header)
            rows = list(_rows(path, reader, header))
    except UnicodeDecodeError as error:
        raise LogError(path, "is no text in UTF-8; save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise LogError(path, f"is no CSV file: {error}", reader.line_num) from error
    return tuple(name for name in header if name and name not in (*REQUIRED, *OPTIONAL)), rows


def _check_header(path: Path, header: list[str]) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        problem = f"the header lacks {', '.join(missing)}; it must name {', '.join(REQUIRED)}, separated by commas"
        raise LogError(path, f"{problem}; it reads: {', '.join(header)[:200] or '(nothing)'}", 1)
    twice = [name for name, count in Counter(header).items() if name and count > 1]
    if twice:
        raise LogError(path, "stands twice in the header", 1, twice[0])


def _rows(path: Path, reader: Iterator[list[str]], header: list[str]) -> Iterator[_Row]:
    for cells in reader:
        line: int = reader.line_num  # type: ignore[attr-defined]
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            raise LogError(path, f"has {len(cells)} cells, the header {len(header)}", line)
        values = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
        x, y, z, p, q, r = (_number(path, line, name, values, MAX_COORDINATE_M, "m") for name in (*VEHICLE, *SENSOR))
        apart = math.dist((x, y, z), (p, q, r))
        if apart < 1e-6:
            raise LogError(path, "the sensor lies on the vehicle, where the SNR is infinite; correct a position", line)
        snr = _number(path, line, "snr_dB", values, MAX_SNR_DB, "dB") if values["snr_dB"] else math.nan
        time = _number(path, line, "time_s", values, math.inf, "s") if "time_s" in values else None
        yield _Row(line, (x, y, z), (p, q, r), values.get("sensor", ""), time, snr)


def _number(path: Path, line: int, column: str, values: dict[str, str], most: float, unit: str) -> float:
    text = values[column]
    if not text:
        hint = "; leave the column out if times are not known" if column == "time_s" else ""
        raise LogError(path, f"is blank; only snr_dB may be, where nothing was heard{hint}", line, column)
    try:
        # Python would accept 1_000.
        value = float(text.replace("_", "?"))
    except ValueError:
        raise LogError(path, f"{text!r} is no number; write one such as -12.5", line, column) from None
    if not math.isfinite(value):
        right = "leave it blank where nothing was heard" if column == "snr_dB" else "correct it"
        raise LogError(path, f"{text!r} is not finite; {right}", line, column)
    if abs(value) > most:
        raise LogError(path, f"{text} {unit} is beyond {most:,.0f} {unit}; check units and columns", line, column)
    return value
