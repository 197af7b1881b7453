"""Names, types and units of the settings of `uwirl-estimate`. Values stand in conf/estimate.yaml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from uwirl.config import schema
from uwirl.config.schema import ChannelConfig, EstimatorConfig, LoggingConfig


@dataclass
class MapConfig:
    from_m: Any = MISSING  # m; [x, y, z] of the vehicle whose links are mapped; null for that of the last message
    z_m: float | None = MISSING  # m; of the map; null for the sensors' mean
    spacing_m: float | None = MISSING  # m; between nodes; null for about 3,500 of them
    capacity_kbps: float | None = MISSING  # kbit/s; what counts as outage below it; null for half the map's median


@dataclass
class EstimateConfig:
    data: str | None = MISSING  # the log, a CSV file
    channel: ChannelConfig = MISSING  # of which only N0, bandwidth and absorption are used
    estimator: EstimatorConfig = MISSING  # how readings become a channel; neither oracle nor disk
    max_readings: int = MISSING  # a log of more is thinned, in [3, 5000]
    map: MapConfig = MISSING  # of capacity and outage
    logging: LoggingConfig = MISSING  # of which only figures is used
    threads: int = MISSING  # of torch


def register() -> None:
    """Make this schema known to Hydra, and those of the groups."""
    schema.register()
    ConfigStore.instance().store(name="estimate_schema", node=EstimateConfig)
