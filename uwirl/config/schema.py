"""Names, types and units of every setting, and the rules of single sections.

Values stand in conf/, rules between sections in `uwirl.config.validate`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING

from uwirl.config import vehicle_bounds
from uwirl.config.checks import MadeConfig, Section, at_least, ruled, unlike, valid_seed
from uwirl.config.motion_schema import (
    BasisConfig,
    CostConfig,
    ExperienceConfig,
    GuidanceConfig,
    PlannerConfig,
    SafetyConfig,
    SolverConfig,
)
from uwirl.config.motion_schema import GuardConfig as GuardConfig
from uwirl.config.motion_schema import IrlConfig as IrlConfig
from uwirl.config.motion_schema import PrintedCostConfig as PrintedCostConfig
from uwirl.config.world_schema import ChannelConfig, ScenarioConfig, VehicleConfig

OURS = "uwirl.snr.estimators."
# Those of uwirl.snr.estimators, which needs torch; a test compares them.
ESTIMATORS = ("least_squares", "generalized_least_squares", "separate", "maximum_likelihood", "disk", "oracle")
InitPart = StrEnum("InitPart", ["estimate", "weights"])
Dtype = StrEnum("Dtype", ["float64", "float32"])


@dataclass
class EstimatorConfig(MadeConfig, family="estimator"):
    # least_squares | generalized_least_squares | separate | maximum_likelihood | disk | oracle; any with yours
    name: str = MISSING
    target: str | None = OURS + "${.name}"  # package.module.function, or a class: docs/extending.md
    robust: bool = False  # leave out readings and sensors that stand apart from the others

    def problems(self) -> Iterator[tuple[str, str]]:
        problem = unlike(self.name, ESTIMATORS)
        if problem and self.target == OURS + self.name:
            yield "name", problem


@dataclass
class LoggingConfig(Section):
    tensorboard: bool = MISSING  # write tb/
    figures: bool = MISSING  # write figures/*.png, and *.pdf of the same for print
    animation: bool = MISSING  # write figures/mission.gif
    progress: bool = MISSING  # bars with the time left, on a terminal


@dataclass
class CheckpointConfig(Section):
    every: int = ruled(at_least(1))  # legs of the learning flight between two saves


@dataclass
class Config(Section):
    scenario: ScenarioConfig = MISSING  # nodes, vehicles, obstacles, water
    channel: ChannelConfig = MISSING  # path loss, noise and fading, the truth of the simulation
    vehicle: VehicleConfig = MISSING  # rigid body, drag, thrusters
    estimator: EstimatorConfig = MISSING  # how readings become a channel
    basis: BasisConfig = MISSING  # features of critic and actor
    cost: CostConfig = MISSING  # what the planner minimises
    guidance: GuidanceConfig = MISSING  # the way among obstacles
    safety: SafetyConfig = MISSING  # the guard between policy and thrusters
    solver: SolverConfig = MISSING  # how Bellman equations become weights
    experience: ExperienceConfig = MISSING  # how the learner flies to learn
    planner: PlannerConfig = MISSING  # what is run
    baseline: PlannerConfig = MISSING  # flown beside a learned policy
    logging: LoggingConfig = MISSING  # what is written besides metrics.json
    checkpoint: CheckpointConfig = field(default_factory=lambda: CheckpointConfig())  # how often a run is saved
    resume: str | None = MISSING  # a checkpoint or run folder, whose run is continued
    init_from: str | None = MISSING  # a checkpoint or run folder, whose results a new run starts from
    init_from_parts: list[InitPart] = MISSING  # what is taken over from there
    seed: int = ruled(valid_seed)  # of everything random, in [0, 2^63)
    threads: int = ruled(at_least(1))  # of torch
    device: str = MISSING  # cpu | cuda | cuda:N | mps
    compile: bool = MISSING  # the world's step: half a minute before the first one, worth it for thousands of worlds
    dtype: Dtype = MISSING  # of the environment; learning is float64 always

    def problems(self) -> Iterator[tuple[str, str]]:
        for key in ("resume", "init_from"):
            if getattr(self, key) == "":
                yield key, "names no checkpoint; give a file or a run folder"
        parts = self.init_from_parts
        if not parts or len(set(parts)) < len(parts):
            yield "init_from_parts", f"needs one or both of {', '.join(InitPart)}, got {parts}"
        if not re.fullmatch(r"cpu|cuda(:\d+)?|mps", self.device):
            yield "device", f"{self.device!r} is none of cpu, cuda, cuda:N, mps"
        if self.device == "mps" and self.dtype == Dtype.float64:
            yield "dtype", "device=mps knows no float64; add dtype=float32, or choose device=cpu"


@dataclass
class SearchConfig(Section):
    """A search, `hydra.sweeper` with hydra/sweeper=search."""

    _target_: str = "hydra_plugins.uwirl_search.Search"  # as Hydra finds it
    seeds: list[int] = MISSING  # each trial is flown with all of them
    n_trials: int = ruled(at_least(1))  # how many points of the space
    n_jobs: int = ruled(at_least(1))  # trials that are drawn at once, none knowing of the others
    direction: str = MISSING  # minimize | maximize: what is done to the mean of J over the seeds
    params: dict[str, str] = MISSING  # setting: what it may be, in Hydra's grammar of sweeps
    sampler: Any = MISSING  # optuna's, of the group hydra/sweeper/sampler

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.seeds or len(set(self.seeds)) < len(self.seeds):
            yield "seeds", f"needs one or more different seeds, got {self.seeds}"
        problem = unlike(self.direction, ("minimize", "maximize"))
        if problem:
            yield "direction", problem


@cache
def register() -> None:
    """Make the schemas known to Hydra.

    A file of a group names its schema in its defaults list where it has keys that `Config` does not give the group.
    """
    vehicle_bounds.register()
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    store.store(group="hydra/sweeper", name="search_schema", node=SearchConfig)
    # Files of classes of one's own once had to name a schema.
    own = {(schema.family, "own_schema"): schema for schema in (EstimatorConfig, BasisConfig, PlannerConfig)}
    for (group, name), schema in (own | MadeConfig.files).items():
        store.store(group=group, name=name, node=schema)
