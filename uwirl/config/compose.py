"""Where the configuration lies and how it is composed outside `hydra.main`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import hydra
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from uwirl.config.schema import Config, register


def folder() -> Path:
    """conf/, inside the package when installed from a wheel, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    packaged = package / "conf"
    return packaged if packaged.is_dir() else package.parent / "conf"


def compose(overrides: Sequence[str] = ()) -> Config:
    """The configuration that a command line with these overrides would give, not yet validated.

    Raises:
        hydra.errors.HydraException, omegaconf.errors.OmegaConfBaseException: unknown keys, groups or types.
    """
    register()
    return to_config(composed("config", overrides))


def composed(name: str, overrides: Sequence[str]) -> DictConfig:
    """A primary configuration, whose schema is registered, with overrides.

    Raises:
        hydra.errors.HydraException, omegaconf.errors.OmegaConfBaseException: unknown keys, groups or types.
    """
    GlobalHydra.instance().clear()
    with hydra.initialize_config_dir(str(folder()), version_base="1.3"):
        return hydra.compose(name, list(overrides))


def to_config(composed: DictConfig) -> Config:
    """Typed objects of a composed configuration, every interpolation resolved.

    Raises:
        omegaconf.errors.OmegaConfBaseException: a mandatory value is missing.
    """
    config = OmegaConf.to_object(composed)
    assert isinstance(config, Config)
    return config
