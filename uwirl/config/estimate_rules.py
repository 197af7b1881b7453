"""Rules of `uwirl-estimate`'s settings. Knows no torch: it answers before anything heavy is imported."""

from __future__ import annotations

import math
from pathlib import Path

from uwirl.config.checks import ConfigError, finite, positive
from uwirl.config.estimate_schema import EstimateConfig, MapConfig
from uwirl.config.own import check_own
from uwirl.config.validate import check_estimator
from uwirl.config.world_rules import check_channel

# Coordinates beyond are no metres of one site.
MAX_COORDINATE_M = 1e6
# The capacity of 500 dB, per kHz: no reading of a log is beyond.
MAX_KBPS_PER_KHZ = 166.0
# Fewer tell nothing; matrices of more take gigabytes and an hour.
LEAST_READINGS, MOST_READINGS = 3, 5000
UNSUITABLE = {
    "oracle": "is the truth of a simulation, which a log does not hold",
    "disk": "knows no distance, so that there is nothing to map; choose another estimator",
}


def validate_estimate(config: EstimateConfig) -> None:
    """Check ranges and cross-field rules, and that the log is a file.

    Raises:
        ConfigError: the first rule that is broken.
    """
    if not config.data:
        raise ConfigError("data", "names no log; give a CSV file, as in `uwirl-estimate data=readings.csv`")
    if not Path(config.data).is_file():
        what = "is a folder" if Path(config.data).is_dir() else "does not exist"
        raise ConfigError("data", f"{config.data} {what}; give a CSV file (from {Path.cwd()})")
    check_channel(config.channel)
    check_estimator(config.estimator)
    if config.estimator.name in UNSUITABLE:
        raise ConfigError("estimator.name", f"{config.estimator.name!r} {UNSUITABLE[config.estimator.name]}")
    if not LEAST_READINGS <= config.max_readings <= MOST_READINGS:
        problem = f"must lie in [{LEAST_READINGS}, {MOST_READINGS:,}], got {config.max_readings:,}"
        raise ConfigError("max_readings", problem)
    check_map(config.map, config.channel.bandwidth_khz)
    if config.threads < 1:
        raise ConfigError("threads", f"must be at least 1, got {config.threads}")
    check_own(config)


def check_map(settings: MapConfig, bandwidth_khz: float) -> None:
    """Finite places, and a capacity that some link could have."""
    if settings.from_m is not None:
        finite(settings.from_m, "map.from_m", 3)
    for key, value in (("from_m", settings.from_m), ("z_m", settings.z_m)):
        for x in [] if value is None else [value] if isinstance(value, float) else value:
            if not (math.isfinite(x) and abs(x) <= MAX_COORDINATE_M):
                raise ConfigError(f"map.{key}", f"must lie within {MAX_COORDINATE_M:,.0f} m, got {x:g}")
    if settings.spacing_m is not None:
        positive(settings.spacing_m, "map.spacing_m")
    if settings.capacity_kbps is not None:
        positive(settings.capacity_kbps, "map.capacity_kbps")
        if settings.capacity_kbps > MAX_KBPS_PER_KHZ * bandwidth_khz:
            most = MAX_KBPS_PER_KHZ * bandwidth_khz
            raise ConfigError(
                "map.capacity_kbps",
                f"{settings.capacity_kbps:g} kbit/s is beyond any link of channel.bandwidth_khz = {bandwidth_khz:g} "
                f"(at most {most:g})",
            )
