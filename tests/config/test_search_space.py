"""Search spaces hold settings that exist, within bounds that may be run; what is not installed is said."""

from __future__ import annotations

import dataclasses
import tomllib
from functools import reduce
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.types import IntervalSweep, RangeSweep
from omegaconf import OmegaConf

from uwirl.config.checks import ConfigError
from uwirl.config.compose import EXTRAS, composed, folder
from uwirl.config.groups import parsed
from uwirl.config.schema import register
from uwirl.config.sweeps import space
from uwirl.config.validate import validate

SPACES = sorted(path.stem for path in (folder() / "hydra" / "sweeper").glob("*.yaml") if path.stem != "search")
SCHEMA = "defaults: [search_schema]\nseeds: [0, 1]\nn_trials: 1\nn_jobs: 1\ndirection: minimize\n"


def words(name: str) -> list[str]:
    file: Any = OmegaConf.load(folder() / "hydra" / "sweeper" / f"{name}.yaml")
    return [f"{key}={value}" for key, value in file.params.items()]


def values(word: str) -> list[Any]:
    """The ends of an interval or range, both of which optuna tries, or all values of a choice."""
    override = parsed(word)
    value = override.value()
    if isinstance(value, IntervalSweep):
        return [value.start, value.end]
    if isinstance(value, RangeSweep):
        return [value.start, value.stop]
    return list(override.sweep_string_iterator())


@pytest.mark.parametrize("name", SPACES)
def test_every_end_of_a_space_may_be_run(make_config, name: str):
    searched = [word for word in words(name) if parsed(word).is_sweep_override()]
    fixed = [word for word in words(name) if word not in searched]
    assert searched
    ends = [[f"{parsed(word).key_or_group}={value}" for value in values(word)] for word in searched]
    corners = [[both[0] for both in ends], [both[-1] for both in ends]]
    for job in [*corners, *([one] for both in ends for one in both)]:
        validate(make_config(*fixed, *job))


@pytest.mark.parametrize("name", SPACES)
def test_a_space_holds_the_defaults(make_config, name: str):
    """Or a search could end worse than where it began, and nobody would know why."""
    fixed = [word for word in words(name) if not parsed(word).is_sweep_override()]
    defaults = dataclasses.asdict(make_config(*fixed))
    for word in set(words(name)) - set(fixed):
        keys = parsed(word).key_or_group.split(".")
        default = reduce(lambda part, key: part[int(key) if isinstance(part, list) else key], keys, defaults)
        found = values(word)
        sweep = parsed(word).value()
        inside = found[0] <= default <= found[1] if isinstance(sweep, IntervalSweep | RangeSweep) else default in found
        assert inside, word


@pytest.mark.parametrize(
    ("plugin", "override", "extra"),
    [
        ("hydra_joblib_launcher", "hydra/launcher=joblib", "sweep"),
        ("hydra_submitit_launcher", "hydra/launcher=submitit_local", "slurm"),
        ("hydra_submitit_launcher", "hydra/launcher=submitit_slurm", "slurm"),
        ("hydra_ray_launcher", "hydra/launcher=ray", "ray"),
        ("hydra_optuna_sweeper", "hydra/sweeper=optuna", "optuna"),
        ("hydra_optuna_sweeper", "hydra/sweeper=search", "optuna"),
        ("hydra_optuna_sweeper", "hydra/sweeper=learning", "optuna"),
    ],
)
def test_what_is_not_installed_is_said(plugin: str, override: str, extra: str):
    if find_spec(f"hydra_plugins.{plugin}"):
        pytest.skip("is installed")
    register()
    for answer in (lambda: space("config", [override]), lambda: composed("config", [override])):
        with pytest.raises(ConfigError) as caught:
            answer()
        assert str(caught.value).startswith("hydra/")
        assert str(caught.value).endswith(f"needs a plugin, pip install 'uwirl[{extra}]'")


def test_a_users_space_on_what_is_not_installed(tmp_path: Path):
    if find_spec("hydra_plugins.hydra_optuna_sweeper"):
        pytest.skip("is installed")
    own(tmp_path, "defaults: [optuna]\nn_trials: 3\n")
    with pytest.raises(ConfigError, match=r"'optuna' needs a plugin, pip install 'uwirl\[optuna\]'"):
        space("config", ["hydra/sweeper=mine"], str(tmp_path))


def test_extras_are_those_of_the_package():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS.values()) <= set(project["optional-dependencies"])


def own(tmp_path: Path, content: str) -> None:
    """hydra/sweeper=mine, in a folder for --config-dir."""
    register()
    (tmp_path / "hydra" / "sweeper").mkdir(parents=True)
    (tmp_path / "hydra" / "sweeper" / "mine.yaml").write_text(content)


def test_the_command_line_comes_before_a_space(tmp_path: Path):
    own(tmp_path, SCHEMA + "params:\n  planner.updates: range(1, 8)\n  solver.prior: interval(0.1, 1)\n")
    line = ["hydra/sweeper=mine", "channel=paper"]
    assert space("config", line, str(tmp_path)) == ["planner.updates=range(1, 8)", "solver.prior=interval(0.1, 1)"]
    assert space("config", [*line, "planner.updates=3"], str(tmp_path)) == ["solver.prior=interval(0.1, 1)"]
    assert space("config", ["channel=paper"], str(tmp_path)) == []


def test_a_search_of_the_command_line_alone(tmp_path: Path):
    """The values that are printed as an example, too."""
    own(tmp_path, SCHEMA)
    assert space("config", ["hydra/sweeper=mine", "planner.updates=range(1,8)"], str(tmp_path)) == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("hydra.sweeper.seeds=[]", "hydra.sweeper.seeds: needs one or more different seeds, got []"),
        ("hydra.sweeper.seeds=[1,1]", "hydra.sweeper.seeds: needs one or more different seeds, got [1, 1]"),
        ("hydra.sweeper.seeds=3", "hydra.sweeper.seeds: must be a list of whole numbers, got 3"),
        ("hydra.sweeper.n_trials=0", "hydra.sweeper.n_trials: must be at least 1, got 0"),
        ("hydra.sweeper.n_jobs=0", "hydra.sweeper.n_jobs: must be at least 1, got 0"),
        ("hydra.sweeper.n_trails=3", "hydra.sweeper.n_trails: no such key; did you mean 'hydra.sweeper.n_trials'?"),
        ("hydra.sweeper.direction=down", "hydra.sweeper.direction: 'down' is none of minimize, maximize"),
        ("seed=3", "seed: of a search is set for each trial; choose with hydra.sweeper.seeds=[0,1,2]"),
        ("seed=1,2", "seed: of a search is set for each trial"),
        ("hydra.sweeper.n_trials=2", "hydra.sweeper.params: names nothing to search; add a setting with the values"),
        (
            "+hydra.sweeper.params.planner.updates=range(1,3)",
            "hydra.sweeper.params.planner.updates: is for files; here write the setting itself, planner.updates=VALUES",
        ),
    ],
)
def test_one_message(tmp_path: Path, line: str, message: str):
    own(tmp_path, SCHEMA)
    with pytest.raises(ConfigError) as caught:
        space("config", ["hydra/sweeper=mine", line], str(tmp_path))
    assert str(caught.value).startswith(message)
