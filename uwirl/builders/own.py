"""Objects of the user's own classes."""

from __future__ import annotations

from functools import partial
from typing import Any

from uwirl.config.checks import ConfigError
from uwirl.config.own import FAMILIES, found, lacking
from uwirl.config.own_schema import OwnConfig


def make_own(config: OwnConfig, key: str, *given: Any, **named: Any) -> Any:
    """An object of a target with its settings; a function with its settings is one already.

    Args:
        config: checked, with a target.
        key: its section.
        given, named: what it is made from besides its settings.

    Raises:
        ConfigError: the object lacks what its class need not have.
    """
    path = str(config.target)
    target = found(path, f"{key}.target")
    if not isinstance(target, type):
        return partial(target, **config.settings)
    made = target(*given, **named, **config.settings)
    missing = lacking(made, FAMILIES[key].protocol)
    if missing:
        raise ConfigError(f"{key}.target", f"{path} is no {FAMILIES[key].protocol}: it has no {', '.join(missing)}")
    return made
