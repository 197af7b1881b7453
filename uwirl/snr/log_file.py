"""Rows of a CSV file with SNR readings, in any order of columns, as spreadsheets and loggers write them.

Columns are separated by commas, semicolons or tabs. Numbers have decimal points, or all through decimal commas.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

VEHICLE = ("vehicle_x_m", "vehicle_y_m", "vehicle_z_m")
SENSOR = ("sensor_x_m", "sensor_y_m", "sensor_z_m")
REQUIRED = (*VEHICLE, *SENSOR, "snr_dB")
OPTIONAL = ("time_s", "vehicle", "sensor")
# UTM northings reach 1e7 m, eastings with the zone in front 6e7 m: a larger number is a mistake in units or columns.
MAX_COORDINATE_M, MAX_SNR_DB = 1e8, 500.0
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
DECIMALS = {".": "points", ",": "commas"}

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


class Row(NamedTuple):
    """One row of a log.

    Attributes:
        line: of the file, counted from 1.
        vehicle, sensor: positions of sender and sensor, m.
        name: of the sensor, or "".
        time: s; 0 in a file without times.
        snr: dB; nan where nothing was received.
    """

    line: int
    vehicle: Place
    sensor: Place
    name: str
    time: float
    snr: float


class LogFile(NamedTuple):
    """What stands in a file.

    Attributes:
        rows: in the order of the file.
        timed: whether the rows have times.
        unused: names of columns that are not used.
        padded: lines at whose ends NUL bytes were skipped.
    """

    rows: list[Row]
    timed: bool
    unused: tuple[str, ...]
    padded: list[int]


def parse(path: Path) -> LogFile:
    """Read a file, and check it row by row.

    Raises:
        LogError: columns are missing, or a row is invalid.
        OSError: the file cannot be opened.
    """
    padded: list[int] = []
    reader = None
    try:
        # Spreadsheets begin a file with a byte order mark.
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = _lines(path, file, padded)
            first = next(lines, "")
            header, separator = _header(path, first)
            reader = csv.reader(lines, delimiter=separator)
            rows = list(_rows(path, reader, header, separator))
    except UnicodeDecodeError as error:
        raise LogError(path, "is no text in UTF-8; save it as CSV in UTF-8") from error
    except csv.Error as error:
        raise LogError(path, f"is no CSV file: {error}", 1 + reader.line_num if reader else 1) from error
    unused = tuple(name for name in header if name and name not in (*REQUIRED, *OPTIONAL))
    return LogFile(rows, "time_s" in header, unused, padded)


def _lines(path: Path, file: Iterable[str], padded: list[int]) -> Iterator[str]:
    """Lines without NUL bytes at their ends: a logger that loses power leaves some between its rows."""
    for number, line in enumerate(file, 1):
        text = line.rstrip("\r\n")
        kept = text.strip("\0")
        if "\0" in kept:
            problem = "has NUL bytes within the row, where something was lost (did the logger lose power?)"
            raise LogError(path, f"{problem}; remove the row", number)
        if kept != text:
            padded.append(number)
        yield kept


def _header(path: Path, line: str) -> tuple[list[str], str]:
    """Names of the columns, and the character that separates them."""

    def names(separator: str) -> list[str]:
        return [name.strip() for name in next(csv.reader([line], delimiter=separator), [])]

    separator = max(SEPARATORS, key=lambda mark: len({*REQUIRED} & {*names(mark)}))
    header = names(separator)
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        problem = f"the header lacks {', '.join(missing)}; it must name {', '.join(REQUIRED)}"
        found = ", ".join(header)[:200] or "(nothing)"
        raise LogError(path, f"{problem}, separated by commas, semicolons or tabs; it reads: {found}", 1)
    twice = [name for name, count in Counter(header).items() if name and count > 1]
    if twice:
        raise LogError(path, "stands twice in the header", 1, twice[0])
    return header, separator


def _rows(path: Path, reader: Iterator[list[str]], header: list[str], separator: str) -> Iterator[Row]:
    # The first line with each kind of decimals.
    decimals: dict[str, int] = {}
    for cells in reader:
        # The header was read before.
        line: int = 1 + reader.line_num  # type: ignore[attr-defined]
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(header):
            raise LogError(path, _miscounted(cells, len(header), separator), line)
        values = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
        x, y, z, p, q, r = (_number(path, line, name, values, MAX_COORDINATE_M, "m") for name in (*VEHICLE, *SENSOR))
        apart = math.dist((x, y, z), (p, q, r))
        if apart < 1e-6:
            raise LogError(path, "the sensor lies on the vehicle, where the SNR is infinite; correct a position", line)
        snr = _number(path, line, "snr_dB", values, MAX_SNR_DB, "dB") if values["snr_dB"] else math.nan
        time = _number(path, line, "time_s", values, math.inf, "s") if "time_s" in values else 0.0
        for name in (*REQUIRED, "time_s"):
            for mark in DECIMALS.keys() & values.get(name, ""):
                decimals.setdefault(mark, line)
        if len(decimals) > 1:
            ways = " and ".join(f"decimal {DECIMALS[mark]} (line {at})" for mark, at in decimals.items())
            raise LogError(path, f"has both {ways}; write all numbers in one way")
        yield Row(line, (x, y, z), (p, q, r), values.get("sensor", ""), time, snr)


def _miscounted(cells: list[str], columns: int, separator: str) -> str:
    text = separator.join(cells)
    for other, name in SEPARATORS.items():
        if other != separator and text.count(other) == columns - 1:
            return f"is separated by {name}, the header by {SEPARATORS[separator]}; use one of them"
    problem = f"has {len(cells)} cells, the header {columns}"
    if separator == "," and len(cells) > columns:
        return f"{problem}; numbers with decimal commas need columns separated by semicolons"
    return problem


def _number(path: Path, line: int, column: str, values: dict[str, str], most: float, unit: str) -> float:
    text = values[column]
    if not text:
        hint = "; leave the column out if times are not known" if column == "time_s" else ""
        raise LogError(path, f"is blank; only snr_dB may be, where nothing was heard{hint}", line, column)
    try:
        # Python would accept 1_000.
        value = float(text.replace("_", "?").replace(",", "."))
    except ValueError:
        raise LogError(path, f"{text!r} is no number; write one such as -12.5", line, column) from None
    if not math.isfinite(value):
        right = "leave it blank where nothing was heard" if column == "snr_dB" else "correct it"
        raise LogError(path, f"{text!r} is not finite; {right}", line, column)
    if abs(value) > most:
        raise LogError(path, f"{text} {unit} is beyond {most:,.0f} {unit}; check units and columns", line, column)
    return value
