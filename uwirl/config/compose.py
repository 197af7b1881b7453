"""Where the configuration lies and how it is composed outside `hydra.main`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from hydra.version import setbase
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from uwirl.config.ablations import check_ablation
from uwirl.config.checks import ConfigError
from uwirl.config.groups import check_overrides, chosen, holders
from uwirl.config.schema import Config, register
from uwirl.config.suggestions import check_known, explained

# The last three are what OmegaConf stumbles into where a section is null.
REFUSALS = (HydraException, OmegaConfBaseException, YAMLError, ValueError, AttributeError, AssertionError)


def folder() -> Path:
    """conf/, inside the package when installed from a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    packaged = package / "conf"
    return packaged if packaged.is_dir() else package.parent / "conf"


def compose(overrides: Sequence[str] = (), config_dir: str | None = None) -> Config:
    """The configuration that a command line with these overrides would give, not yet validated.

    Args:
        overrides: as on the command line.
        config_dir: a folder of the user's own files, as after --config-dir.

    Raises:
        ConfigError: unknown keys, groups, options or types, or an ablation that is undone.
    """
    register()
    return to_config(composed("config", overrides, config_dir))


def composed(name: str, overrides: Sequence[str], config_dir: str | None = None, ablation: bool = True) -> DictConfig:
    """A primary configuration, whose schema is registered, with overrides.

    Args:
        name: of its file.
        overrides: as on the command line.
        config_dir: a folder of the user's own files, as after --config-dir.
        ablation: whether it must hold.

    Raises:
        ConfigError: unknown keys, groups, options or types, or an ablation that is undone.
    """
    with searching(config_dir) as loader:
        groups = chosen(loader, name)
        check_overrides(overrides, loader, groups)
        try:
            config = hydra.compose(name, list(overrides), return_hydra_config=True)
            choices = dict(config.hydra.runtime.choices)
        except REFUSALS as error:
            raise explained(error, overrides, groups, partial(holders, loader, groups)) from None
        with open_dict(config):
            del config["hydra"]
        check_composed(config, choices, loader if ablation else None)
        return config


@contextmanager
def searching(config_dir: str | None = None) -> Iterator[ConfigLoader]:
    """Hydra, looking for files where `hydra.main` would: `hydra.initialize_config_dir` knows no second folder.

    Raises:
        ConfigError: config_dir is no folder.
    """
    setbase("1.3")
    path = create_config_search_path(str(folder()))
    if config_dir is not None:
        own = Path(config_dir).resolve()
        if not own.is_dir():
            raise ConfigError("--config-dir", f"{own} is no folder")
        path.prepend("command-line", f"file://{own}", SearchPathQuery(provider="schema"))
    GlobalHydra.instance().clear()
    Hydra.create_main_hydra2(task_name="app", config_search_path=path)
    try:
        yield GlobalHydra.instance().config_loader()
    finally:
        GlobalHydra.instance().clear()


def check_composed(config: DictConfig, choices: Mapping[str, Any], loader: ConfigLoader | None) -> None:
    """What Hydra lets pass: keys added with + that no schema has, and ablations that are undone.

    Raises:
        ConfigError: the first of them.
    """
    check_known(config, [group for group in choices if not group.startswith("hydra/")])
    if loader is not None:
        check_ablation(config, choices, loader)


def to_config(composed: DictConfig) -> Config:
    """Typed objects of a composed configuration, every interpolation resolved.

    Raises:
        ConfigError: a mandatory value is missing, or an interpolation leads nowhere.
    """
    config = to_object(composed)
    assert isinstance(config, Config)
    return config


def to_object(composed: DictConfig) -> Any:
    """As `to_config`, of any schema."""
    try:
        return OmegaConf.to_object(composed)
    except OmegaConfBaseException as error:
        raise explained(error) from None
