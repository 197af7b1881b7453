"""Classes of the user's own: found by their dotted path, and held against what their family must do.

The families' Protocols need torch, and so may the user's modules: they are imported only where a target is given.
"""

from __future__ import annotations

import inspect
import pkgutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from uwirl.config.checks import ConfigError, MadeConfig
from uwirl.config.schema import OURS, BasisConfig, ChannelConfig, EstimatorConfig, PlannerConfig, VehicleConfig
from uwirl.config.suggestions import did_you_mean, listed, similar


@dataclass(frozen=True)
class Family:
    """What may be the user's own.

    Attributes:
        protocol: dotted path of the Protocol, or of the class that it must extend.
        given: what it is made from besides the section, by position.
        named: what besides, by name.
        offered: what it is made from if it takes something by that name.
        calls: what a function gets that is one of the family by itself; empty where only objects are.
        instead: a class that it may extend instead.
    """

    protocol: str
    given: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    offered: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    instead: str | None = None


# Of stage 2: a planner gets those that it takes by name.
PARTS = ("cost", "guard", "guidance", "basis", "solver", "experience")
# By the schemas whose sections may be of any class; all others have settings of uwirl's own.
FAMILIES: dict[type[MadeConfig], Family] = {
    ChannelConfig: Family("uwirl.world.acoustics.LinkBudget", instead="uwirl.world.acoustics.Channel"),
    VehicleConfig: Family("uwirl.world.vehicle.Dynamics", named=("dtype", "device")),
    EstimatorConfig: Family("uwirl.snr.estimators.Estimator", calls=("readings", "budget")),
    BasisConfig: Family("uwirl.motion.features.MotionBasis", given=("cost",)),
    PlannerConfig: Family("uwirl.motion.planner.Planner", offered=PARTS),
}


def check_targets(config: Any) -> None:
    """Whether every class of the user's own can be imported, does what its family must, and takes its settings.

    Raises:
        ConfigError: the first that does not.
    """
    for key, section in vars(config).items():
        if not isinstance(section, MadeConfig):
            continue
        target, family = section.target or type(section).target, FAMILIES.get(type(section))
        if family is not None and target is None:
            raise ConfigError(f"{key}.target", "names no class of yours; give package.module.Class")
        if family is not None and target not in (type(section).target, OURS + getattr(section, "name", "")):
            _check(section, str(target), key, family)
        elif not (target or "uwirl.").startswith("uwirl."):
            raise ConfigError(f"{key}.target", f"is a class of yours, which stands {_place(section, key)}")
        elif section.settings:
            raise ConfigError(f"{key}.settings", f"are those of {key}.target, which names no class of yours")


def _place(section: MadeConfig, key: str) -> str:
    """Where a class of one's own may stand instead."""
    if any(schema.family == section.family for schema in FAMILIES):
        group = section.family if key == section.family else f"{section.family}@{key}"
        return f"only with {group}=custom, or in a file without a schema"
    return f"in {', '.join(schema.family for schema in FAMILIES)} only"


def _check(section: MadeConfig, path: str, key: str, family: Family) -> None:
    target, given = found(path, f"{key}.target"), family.given
    if isinstance(target, type):
        problem = misfit(target, pkgutil.resolve_name(family.protocol))
        if family.instead and issubclass(target, pkgutil.resolve_name(family.instead)):
            given, problem = ("budget",), None
        if problem:
            raise ConfigError(f"{key}.target", f"{path} is no {family.protocol}: {problem}")
    elif family.calls and callable(target):
        given = family.calls
    else:
        raise ConfigError(f"{key}.target", f"{path} is no class{' and no function' if family.calls else ''}")
    try:
        signature = inspect.signature(target)
    except ValueError:
        raise ConfigError(f"{key}.target", f"{path} does not tell what it takes") from None
    # As `make` does: what a class does not take is not for it.
    names, anything = taken(target)
    apart = (*section.values(), *family.named)
    offered = {name for name in family.offered if name in names} - section.settings.keys()
    own = [name for name in names[len(given) :] if name not in offered.union(apart)]
    for name in section.settings:
        setting = f"{key}.settings.{name}"
        if name in apart:
            raise ConfigError(setting, f"is no setting of the class alone; set {name} outside settings")
        if not (anything or name in own):
            near = did_you_mean([f"{key}.settings.{other}" for other in similar(name, own)])
            raise ConfigError(setting, f"{path} takes {listed(own) or 'no settings'}{near}")
    try:
        keys = [name for name in apart if anything or name in names]
        signature.bind(*given, **dict.fromkeys([*keys, *offered]), **section.settings)
    except TypeError as error:
        raise ConfigError(f"{key}.settings", f"{path} cannot be made of {section.settings}: {error}") from None


def found(path: str, key: str) -> Any:
    """What a dotted path names, of the installed packages or the working folder.

    Raises:
        ConfigError: there is no such thing.
    """
    module, _, name = path.rpartition(".")
    if not module or not all(part.isidentifier() for part in path.split(".")):
        raise ConfigError(key, f"must be package.module.Class, got {path!r}")
    # The `uwirl` command, unlike `python`, does not look there.
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        holder = import_module(module)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            problem = f"no module {error.name!r}, neither installed nor in {Path.cwd()} nor on PYTHONPATH"
        else:
            problem = f"{module} cannot be imported: {type(error).__name__}: {' '.join(str(error).split())}"
        raise ConfigError(key, problem) from error
    if not hasattr(holder, name):
        near = [f"{module}.{other}" for other in similar(name, vars(holder))]
        raise ConfigError(key, f"{module} has no {name!r}{did_you_mean(near)}")
    return getattr(holder, name)


def misfit(target: type, protocol: type) -> str | None:
    """What a class lacks of a Protocol's methods, or of a base class; None if nothing."""
    if not _is_protocol(protocol):
        return None if issubclass(target, protocol) else "it must be a subclass"
    for name, value in _members(protocol):
        if not inspect.isfunction(value) or (name != "__call__" and name.startswith("_")):
            continue
        parameters = list(inspect.signature(value).parameters.values())[1:]
        shown = f"{name}({', '.join(p.name for p in parameters)})"
        # getattr would find how classes themselves are called, and what the Protocol leaves open.
        own = next((vars(c)[name] for c in target.__mro__ if name in vars(c) and not _is_protocol(c)), None)
        if not callable(own):
            return f"it has no {shown}"
        needed = [p.name for p in parameters if p.default is p.empty]
        optional = [p.name for p in parameters if p.default is not p.empty]
        try:
            inspect.signature(own).bind("self", *needed, **dict.fromkeys(optional))
        except TypeError as error:
            return f"{shown} cannot be called so: {error}"
    return None


def lacking(made: Any, path: str) -> list[str]:
    """What an object has not of a Protocol besides methods, by the Protocol's dotted path."""
    names = [name for name, value in _members(pkgutil.resolve_name(path)) if isinstance(value, property)]
    holders = {name: next((c for c in type(made).__mro__ if name in vars(c)), object) for name in names}
    return [name for name in names if _is_protocol(holders[name]) or not hasattr(made, name)]


def _members(protocol: type) -> list[tuple[str, Any]]:
    """Those of a Protocol and of the Protocols that it extends."""
    return [member for base in filter(_is_protocol, protocol.__mro__) for member in vars(base).items()]


def _is_protocol(protocol: type) -> bool:
    return bool(getattr(protocol, "_is_protocol", False))


def taken(target: Callable[..., Any]) -> tuple[list[str], bool]:
    """Names of what a function or class takes, of what it hands on to a class of ours too; whether it takes others."""
    classes = [c for c in getattr(target, "__mro__", ()) if "__init__" in vars(c) and c is not object]
    names: list[str] = []
    for maker in classes or [target]:
        parameters = inspect.signature(maker).parameters.values()
        names += [p.name for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            # What a class of the user's own does with the rest, only it knows.
            return names, maker is not target and not maker.__module__.startswith("uwirl.")
    return names, True
