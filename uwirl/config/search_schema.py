"""Names and types of the settings of a search, `hydra.sweeper` with hydra/sweeper=search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from omegaconf import MISSING


@dataclass
class SearchConfig:
    _target_: str = "hydra_plugins.uwirl_search.Search"  # as Hydra finds it
    seeds: list[int] = MISSING  # each trial is flown with all of them; the mean of J is made small
    n_trials: int = MISSING  # how many points of the space
    n_jobs: int = MISSING  # trials that are drawn at once, none knowing of the others
    direction: str = MISSING  # minimize | maximize
    params: dict[str, str] = MISSING  # setting: what it may be, in Hydra's grammar of sweeps
    sampler: Any = MISSING  # optuna's, of the group hydra/sweeper/sampler
