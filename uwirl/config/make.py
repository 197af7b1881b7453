"""One way from a section of the configuration to an object, of uwirl's classes and of the user's own alike."""

from __future__ import annotations

from functools import partial
from typing import Any

from hydra.errors import HydraException
from hydra.utils import instantiate

from uwirl.config.checks import ConfigError, MadeConfig
from uwirl.config.custom import FAMILIES, found, lacking, taken


def make(section: MadeConfig, *given: Any, **offered: Any) -> Any:
    """The object that a section describes; a function with its settings, such as an estimator, is one already.

    Args:
        section: validated. Its class is made from its own keys and those of `settings`, by name.
        given: what the class is made from besides, by position.
        offered: what it is made from if it takes something by that name; a key of the section by the same name gives
            way, one of `settings` does not.

    Raises:
        ConfigError: there is no such class, or its objects lack what their family must have.
    """
    key, path = f"{section.family}.target", section.target or type(section).target
    if path is None:
        raise ConfigError(key, "names no class; give package.module.Class")
    # As Hydra would have filled it in.
    path = path.replace("${.name}", getattr(section, "name", ""))
    target = found(path, key)
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
