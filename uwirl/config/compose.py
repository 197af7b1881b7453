"""Where the configuration lies and how it is composed outside `hydra.main`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

import hydra
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from hydra.core.plugins import Plugins
from hydra.errors import HydraException, MissingConfigException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import InterpolationResolutionError, MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

from uwirl.config.ablations import check_ablation, check_experiment
from uwirl.config.chain import spread
from uwirl.config.checks import ConfigError
from uwirl.config.groups import Groups, for_what_is_named, is_schema, none_of
from uwirl.config.keys import Keys, field_types
from uwirl.config.overrides import key_of
from uwirl.config.schema import Config, register

# What files that do not fit together end in.
REFUSALS = (HydraException, OmegaConfBaseException, YAMLError, ValueError)
# Options of Hydra's groups that a plugin brings, and groups that only one has: the extra with it.
EXTRAS = {
    "hydra/launcher/joblib": "sweep",
    "hydra/launcher/submitit_local": "slurm",
    "hydra/launcher/submitit_slurm": "slurm",
    "hydra/launcher/ray": "ray",
    "hydra/launcher/ray_aws": "ray",
    "hydra/sweeper/optuna": "optuna",
    "hydra/sweeper/sampler": "optuna",
}


def folder() -> Path:
    """conf/, inside the package when installed from a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    packaged = package / "conf"
    return packaged if packaged.is_dir() else package.parent / "conf"


class OwnFolder(SearchPathPlugin):
    """The user's own folder, put where --config-dir puts it: `initialize_config_dir` knows no second one."""

    path: Path | None = None

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        if self.path is not None:
            search_path.append("command-line", f"file://{self.path}")


@contextmanager
def searching(config_dir: str | None = None) -> Iterator[ConfigLoader]:
    """Hydra, looking for files where `hydra.main` would.

    Args:
        config_dir: a folder of the user's own files, as after --config-dir.

    Raises:
        ConfigError: config_dir is no folder.
    """
    own = None if config_dir is None else Path(config_dir).resolve()
    if own is not None and not own.is_dir():
        raise ConfigError("--config-dir", f"{own} is no folder")
    Plugins.instance().register(OwnFolder)
    # That of an experiment's script, perhaps.
    GlobalHydra.instance().clear()
    OwnFolder.path = own
    try:
        with hydra.initialize_config_dir(str(folder()), version_base="1.3"):
            yield GlobalHydra.instance().config_loader()
    finally:
        OwnFolder.path = None


def compose(overrides: Sequence[str] = (), config_dir: str | None = None) -> Config:
    """The configuration that a command line with these overrides would give, not yet validated.

    Args:
        overrides: as on the command line.
        config_dir: a folder of the user's own files, as after --config-dir.

    Raises:
        ConfigError: unknown keys, groups, options or types, or an ablation that is undone.
    """
    register()
    config = to_object(composed("config", for_what_is_named(overrides), config_dir))
    assert isinstance(config, Config)
    return config


def composed(
    name: str, words: Sequence[str], config_dir: str | None = None, ablation: bool = True, whole: bool = False
) -> DictConfig:
    """A primary configuration, whose schema is registered, with overrides.

    Files are composed by Hydra, once for the same choices; each value is held against what they gave, and set on it.

    Args:
        name: of its file.
        words: as on the command line.
        config_dir: a folder of the user's own files, as after --config-dir.
        ablation: whether it must hold.
        whole: whether Hydra's own settings are part of it.

    Raises:
        ConfigError: unknown keys, groups, options or types, or an ablation that is undone.
    """
    with searching(config_dir) as loader:
        shipped = config_dir is None and not any(word.startswith("hydra.searchpath=") for word in words)
        groups = _shipped_groups(name) if shipped else Groups(loader, name)
        chosen, values = groups.split(words)
        try:
            config = deepcopy(_shipped_files(name, tuple(chosen))) if shipped else _files(name, chosen)
        except REFUSALS as error:
            raise _refusal(error, groups, chosen) from None
        keys = Keys.of(config, list(groups.defaults), groups.holders)
        for override in values:
            _set(config, override, keys)
        if not whole:
            with open_dict(config):
                choices = config.pop("hydra").runtime.choices
            check_composed(config, choices, groups if ablation else None, words)
        return config


def _files(name: str, chosen: Sequence[str]) -> DictConfig:
    """What files give, Hydra's own settings among it."""
    return hydra.compose(name, list(chosen), return_hydra_config=True)


# The program's own files nobody edits meanwhile.
_shipped_files = cache(_files)


@cache
def _shipped_groups(name: str) -> Groups:
    return Groups(GlobalHydra.instance().config_loader(), name)


def _set(config: DictConfig, override: Override, keys: Keys) -> None:
    """As Hydra would, after a look at the key.

    Raises:
        ConfigError: there is no such key, or the value is of another type.
    """
    key, value = override.key_or_group, override.value()
    added = override.is_add() or override.is_force_add()
    nested: Any = value
    for part in reversed(key.split(".")):
        nested = {part: nested}
    replace(keys, added=added).check(nested, node=config)
    there = OmegaConf.select(config, key, throw_on_missing=False, throw_on_resolution_failure=False)
    if override.is_add() and there is not None and not isinstance(value, (dict, list)):
        raise ConfigError(key, f"is there already; drop the +, as in {key}=VALUE")
    try:
        OmegaConf.update(config, key, value, merge=True, force_add=added)
    except OmegaConfBaseException as error:
        raise ConfigError(key, first_line(error)) from None


def check_composed(config: DictConfig, choices: Mapping[str, Any], groups: Groups | None, words: Sequence[str]) -> None:
    """What Hydra lets pass: keys that no schema has, lists where numbers should be, choices that are undone.

    Args:
        config: composed, without Hydra's own settings.
        choices: Hydra's, option by group.
        groups: that choices are found in; without, they need not hold.
        words: the command line.

    Raises:
        ConfigError: the first of them.
    """
    names = [group for group in choices if not group.startswith("hydra/")]
    Keys.of(config, names).check(OmegaConf.to_container(config), node=config)
    named = list(map(key_of, words))
    starts = any(key.startswith("scenario.start") for key in named)
    if starts and "scenario.vehicles" in named and config.scenario.vehicles is not None:
        raise ConfigError("scenario.vehicles", "spreads the vehicles by itself; leave it or scenario.start out")
    if groups is not None:
        check_ablation(config, choices, groups)
        check_experiment(choices, groups, words)


def to_object(composed: DictConfig) -> Any:
    """Typed objects of a composed configuration, every interpolation resolved.

    Raises:
        ConfigError: a mandatory value is missing, or an interpolation leads nowhere.
    """
    try:
        config = _plain(OmegaConf.to_object(composed))
        return spread(config) if isinstance(config, Config) else config
    except MissingMandatoryValue as error:
        # OmegaConf writes entries of lists as no command line takes them.
        key = re.sub(r"\[(\d+)\]", r".\1", str(error.full_key))
        raise ConfigError(key, f"has no value; give it one with {key}=VALUE") from None
    except InterpolationResolutionError as error:
        raise ConfigError(str(error.full_key), f"refers to what is not there: {first_line(error)}") from None
    except OmegaConfBaseException as error:
        raise ConfigError(str(error.full_key or "configuration"), first_line(error)) from None


def _plain(value: Any) -> Any:
    """Names that are choices as text, which YAML, JSON and checkpoints take."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    for field in fields(value) if is_dataclass(value) else ():
        setattr(value, field.name, _plain(getattr(value, field.name)))
    return value.value if isinstance(value, Enum) else value


def first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].strip()


def _refusal(error: BaseException, groups: Groups, chosen: Sequence[str]) -> ConfigError:
    """Why files cannot be composed."""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        return _not_there(error.missing_cfg_file, [o for o in error.options or () if not is_schema(o)])
    try:
        _check_files(groups, chosen)
    except ConfigError as found:
        return found
    except REFUSALS:
        pass
    # Where an error has a cause, Hydra puts the reason there.
    lines = dict.fromkeys(first_line(e) for e in (error, error.__cause__) if e is not None)
    return ConfigError("configuration", "; ".join(lines))


def _not_there(path: str, options: Sequence[str]) -> ConfigError:
    group, _, option = path.rpartition("/")
    extra = EXTRAS.get(path) or (None if options else EXTRAS.get(group))
    if extra:
        return ConfigError(group, f"{option!r} needs a plugin, pip install 'uwirl[{extra}]'")
    return none_of(group or path, option, options)


def _check_files(groups: Groups, chosen: Sequence[str]) -> None:
    """Hold every file against the schemas, in Hydra's order.

    Raises:
        ConfigError: a key that no schema has, or a value of another type; says in which file.
    """
    schemas: dict[str, Any] = {}
    for default in groups.loader.compute_defaults_list(groups.name, list(chosen), RunMode.RUN).defaults:
        path, package = default.config_path or "", default.package or ""
        if is_schema(path.rpartition("/")[2]):
            schemas[package] = OmegaConf.get_type(ConfigStore.instance().load(f"{path}.yaml").node)
            continue
        file = groups.load(path)
        if file is not None:
            root = field_types(schemas[""]) if "" in schemas else {}
            content: Any = OmegaConf.to_container(file)
            content = {key: value for key, value in content.items() if key not in ("defaults", "hydra")}
            Keys(schemas, where=f" (in {path})").check(content, root.get(package, Any), package)
