"""Groups and their options as Hydra finds them, and overrides of groups, answered before anything is composed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig
from yaml import YAMLError

from uwirl.config.catalogue import is_schema
from uwirl.config.checks import ConfigError
from uwirl.config.overrides import section_of
from uwirl.config.suggestions import did_you_mean, listed, similar


def options(loader: ConfigLoader, group: str) -> list[str]:
    """What may be chosen in a group, the user's own files too."""
    return [option for option in loader.get_group_options(group) if not is_schema(option)]


def load(loader: ConfigLoader, path: str) -> DictConfig | None:
    """A YAML file of any folder that Hydra searches, its defaults list included; None if there is none.

    Raises:
        ConfigError: it is no YAML.
    """
    for source in loader.get_sources():
        if source.scheme() != "structured" and source.is_config(path):
            try:
                config = source.load_config(path).config
            except YAMLError as error:
                text = " ".join(str(error).split())
                raise ConfigError(path.rpartition("/")[0] or path, f"{path}.yaml cannot be read: {text}") from None
            return config if isinstance(config, DictConfig) else None
    return None


def holders(loader: ConfigLoader, defaults: Mapping[str, str], key: str) -> list[str]:
    """Options, such as `planner=pd`, whose files set a key."""
    section, _, leaf = key.partition(".")
    found = []
    for entry in defaults:
        group, _, package = entry.partition("@")
        if (package or group) == section and leaf:
            files = {option: load(loader, f"{group}/{option}") for option in options(loader, group)}
            found += [f"{entry}={option}" for option, file in files.items() if file is not None and leaf in file]
    return found


def chosen(loader: ConfigLoader, name: str) -> dict[str, str]:
    """Groups of a primary configuration, as an override names them (`planner@baseline`), and their default options."""
    primary = load(loader, name)
    assert primary is not None
    entries = [entry for entry in primary.defaults if isinstance(entry, DictConfig)]
    pairs = [(str(group), str(option)) for entry in entries for group, option in entry.items()]
    return {group: option for group, option in pairs if not group.startswith("override ")}


def parsed(override: str) -> Override:
    """One word of the command line.

    Raises:
        ConfigError: it is not of the form key=value, or its value cannot be read.
    """
    if override.startswith("="):
        raise ConfigError(override, "names no key; write KEY=VALUE")
    try:
        return OverridesParser.create().parse_override(override)
    except HydraException as error:
        key, equal, value = override.partition("=")
        if not equal and not override.startswith("~"):
            raise ConfigError(override, f"is no setting; write {override.strip() or 'KEY'}=VALUE") from None
        reason = str(error).splitlines()[0]
        rule = "quote text that holds any of , : [ ] { } = or blanks, as in 'key=\"a, b\"'"
        raise ConfigError(key or override, f"{value or override!r} cannot be read ({reason}); {rule}") from None


def check_overrides(words: Sequence[str], loader: ConfigLoader, defaults: Mapping[str, str]) -> None:
    """Refuse what cannot be read, groups and options that are not there, and deletions.

    Args:
        words: the command line.
        loader: that finds the files.
        defaults: groups of the primary configuration and their options.

    Raises:
        ConfigError: the first of them.
    """
    overrides = [parsed(word) for word in words]
    # Files of a search path that is itself overridden are Hydra's to find.
    if any(override.key_or_group == "hydra.searchpath" for override in overrides):
        return
    groups = loader.list_groups("")
    packages = {group.partition("@")[2]: group for group in defaults if "@" in group}
    for override in overrides:
        key = override.key_or_group
        if section_of(key) == "hydra":
            continue
        if override.is_sweep_override():
            line = f"{(override.input_line or '').partition('=')[2]} is a sweep over several values"
            raise ConfigError(key, f"{line}; add --multirun to run each, or brackets if it is one list")
        if key in groups:
            _check_choice(override, loader, defaults)
        elif override.package is not None:
            raise ConfigError(
                key, f"no such group{did_you_mean(similar(key, defaults))} (there are {listed(defaults)})"
            )
        elif override.is_delete():
            raise ConfigError(key, f"cannot be deleted, every run needs it; set it with {key}=VALUE")
        elif key in packages:
            group = packages[key]
            raise ConfigError(key, f"is a group of settings; choose it with {group}={override.value()}")


def _check_choice(override: Override, loader: ConfigLoader, defaults: Mapping[str, str]) -> None:
    group = override.key_or_group
    key = f"{group}@{override.package}" if override.package else group
    if key not in defaults and not (override.is_add() and override.package is None and group not in _known(defaults)):
        near = [known for known in defaults if known.partition("@")[0] == group] or similar(key, defaults)
        raise ConfigError(key, f"is no group to choose from here{did_you_mean(near)} (there are {listed(defaults)})")
    if override.is_delete():
        there = options(loader, group)
        instead = f"{key}=none" if "none" in there else f"one of {key}={listed(there)}"
        raise ConfigError(key, f"cannot be left out; choose {instead}")
    value: Any = override.value()
    if key in defaults and (override.is_add() or override.is_force_add()):
        raise ConfigError(key, f"is chosen already; drop the +, as in {key}={value}")
    if isinstance(value, list):
        raise ConfigError(key, f"takes one option, got the list {(override.input_line or '').partition('=')[2]}")
    if isinstance(value, str) and not is_schema(value) and load(loader, f"{group}/{value}") is not None:
        return
    there = options(loader, group)
    near = [f"{key}={name}" for name in similar(str(value), there)]
    raise ConfigError(key, f"{'null' if value is None else repr(value)} is none of {listed(there)}{did_you_mean(near)}")


def _known(defaults: Mapping[str, str]) -> set[str]:
    return {group.partition("@")[0] for group in defaults}
