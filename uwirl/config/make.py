"""Objects from sections of the configuration, whether the class is one of uwirl's or a custom one."""

from __future__ import annotations

from functools import partial
from typing import Any

from hydra.errors import HydraException
from hydra.utils import instantiate

from uwirl.config.checks import ConfigError, MadeConfig
from uwirl.config.custom import FAMILIES, found, lacking, taken


def make(section: MadeConfig, *given: Any, **offered: Any) -> Any:
    """The object that a section describes; for a function, such as an estimator, the function with its settings.

    Args:
        section: a validated section, whose keys and `settings` are passed by name.
        given: further arguments, passed by position.
        offered: further arguments, passed by name if the class takes them; they replace keys of the section, but not
            of `settings`.

    Raises:
        ConfigError: the class does not exist, or the object lacks methods of its family.
    """
    key, path, target = _target(section)
    names, anything = taken(target)
    if not isinstance(target, type) and not given:
        return partial(target, **{name: value for name, value in offered.items() if name in names}, **section.settings)
    parts = {name: value for name, value in (section.values() | offered).items() if anything or name in names}
    try:
        # Settings may hold objects of their own, by `_target_`. What is given never passes through OmegaConf, which
        # takes dataclasses for settings.
        maker = instantiate({"_target_": path, "_partial_": True, "_convert_": "all", **section.settings})
    except HydraException as error:
        raise ConfigError(f"{section.family}.settings", " ".join(str(error).split())) from None
    made = maker(*given, **{name: value for name, value in parts.items() if name not in section.settings})
    family = FAMILIES.get(type(section))
    missing = lacking(made, family.protocol) if family else []
    if family and missing:
        raise ConfigError(key, f"{path} is no {family.protocol}: it has no {', '.join(missing)}")
    return made


def takes(section: MadeConfig, name: str) -> bool:
    """Whether the class of a section takes an argument of this name.

    Raises:
        ConfigError: the class does not exist.
    """
    names, anything = taken(_target(section)[2])
    return anything or name in names


def _target(section: MadeConfig) -> tuple[str, str, Any]:
    """Key, dotted path and class, or function, of a section."""
    key, path = f"{section.family}.target", section.target or type(section).target
    if path is None:
        raise ConfigError(key, "names no class; give package.module.Class")
    # As Hydra would have interpolated it.
    path = path.replace("${.name}", getattr(section, "name", ""))
    return key, path, found(path, key)
