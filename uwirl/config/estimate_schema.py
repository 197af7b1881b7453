"""Names, types, units and rules of the settings of `uwirl-estimate`. Values stand in conf/estimate.yaml."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from uwirl.config import schema
from uwirl.config.checks import Section, at_least, numbers, positive, ruled
from uwirl.config.schema import ChannelConfig, EstimatorConfig, LoggingConfig

# Coordinates beyond are no metres of a grid, such as UTM with the zone in front of the easting.
MAX_COORDINATE_M = 1e8
# The capacity of 500 dB, per kHz: no reading of a log is beyond.
MAX_KBPS_PER_KHZ = 166.0
# Fewer tell nothing; matrices of more take gigabytes and an hour.
LEAST_READINGS, MOST_READINGS = 3, 5000
UNSUITABLE = {
    "oracle": "is the truth of a simulation, which a log does not hold",
    "disk": "knows no distance, so that there is nothing to map; choose another estimator",
}


@dataclass
class MapConfig(Section):
    # m; [x, y, z] of the vehicle whose links are mapped; null for that of the last message
    from_m: Any = ruled(numbers(3))
    z_m: float | None = MISSING  # m; of the map; null for the sensors' mean
    spacing_m: float | None = ruled(positive)  # m; between nodes; null for about 3,500 of them
    # kbit/s; what counts as outage below it; null for half the map's median
    capacity_kbps: float | None = ruled(positive)

    def problems(self) -> Iterator[tuple[str, str]]:
        for key, places in ("from_m", self.from_m or []), ("z_m", [] if self.z_m is None else [self.z_m]):
            for x in places:
                if not (math.isfinite(x) and abs(x) <= MAX_COORDINATE_M):
                    yield key, f"must lie within {MAX_COORDINATE_M:,.0f} m, got {x:g}"


@dataclass
class EstimateConfig(Section):
    data: str | None = MISSING  # the log, a CSV file
    channel: ChannelConfig = MISSING  # of which only N0, bandwidth and absorption are used
    estimator: EstimatorConfig = MISSING  # how readings become a channel; neither oracle nor disk
    max_readings: int = MISSING  # a log of more is thinned, in [3, 5000]
    map: MapConfig = MISSING  # of capacity and outage
    logging: LoggingConfig = MISSING  # of which only figures and progress are used
    threads: int = ruled(at_least(1))  # of torch

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.data:
            yield "data", "names no log; give a CSV file, as in `uwirl-estimate data=readings.csv`"
        path = Path(self.data or "")
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            yield "data", f"{self.data} {what}; give a CSV file (from {Path.cwd()})"
        if self.estimator.name in UNSUITABLE:
            yield "estimator.name", f"{self.estimator.name!r} {UNSUITABLE[self.estimator.name]}"
        if not LEAST_READINGS <= self.max_readings <= MOST_READINGS:
            yield "max_readings", f"must lie in [{LEAST_READINGS}, {MOST_READINGS:,}], got {self.max_readings:,}"
        capacity, bandwidth = self.map.capacity_kbps, self.channel.bandwidth_khz
        if capacity is not None and capacity > MAX_KBPS_PER_KHZ * bandwidth:
            link = f"channel.bandwidth_khz = {bandwidth:g} (at most {MAX_KBPS_PER_KHZ * bandwidth:g})"
            yield "map.capacity_kbps", f"{capacity:g} kbit/s is beyond any link of {link}"


@cache
def register() -> None:
    """Make this schema known to Hydra, and those of the groups."""
    schema.register()
    ConfigStore.instance().store(name="estimate_schema", node=EstimateConfig)
