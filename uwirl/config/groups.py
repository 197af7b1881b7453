"""Groups and their options as Hydra finds them, and words of a command line, answered before anything is composed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig
from yaml import YAMLError

from uwirl.config.checks import ConfigError
from uwirl.config.overrides import PATHS, key_of, quoted, section_of
from uwirl.config.suggestions import did_you_mean, listed, similar

# Instead of a value.
UNREADABLE = object()


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
            raise ConfigError(override, "is no setting; write KEY=VALUE, as in seed=3") from None
        reason = str(error).splitlines()[0]
        rule = "quote text with other signs than A-Z a-z 0-9 _ . / - + * @ % $ ? |, as in 'key=\"a, b\"'"
        raise ConfigError(key or override, f"{value or override!r} cannot be read ({reason}); {rule}") from None


def with_path(word: str) -> str:
    """A word whose value is a path, quoted if Hydra would read another than what stands there, ~ for one's home too."""
    key, equal, text = word.partition("=")
    if key_of(word) not in PATHS or not equal:
        return word
    value: Any = UNREADABLE
    with suppress(ConfigError):
        value = parsed(word).value()
    parts = text.split(",")
    if value is UNREADABLE and len(parts) > 1 and not os.path.lexists(os.path.expanduser(text)):
        return f"{key}=" + ",".join(with_path(f"{key}={part}").partition("=")[2] for part in parts)
    path = os.path.expanduser(value if isinstance(value, str) else text)
    # Several, a number or null are what they seem unless there is such a file.
    named = isinstance(value, str) or value is UNREADABLE or os.path.lexists(path)
    return f"{key}={quoted(path)}" if named and value != path else word


def for_what_is_named(words: Sequence[str]) -> list[str]:
    """The command line without the default experiment where a scenario is named, whose values it would replace."""
    named = set(map(key_of, words))
    return [*words, "experiment=none"] if "scenario" in named and "experiment" not in named else list(words)


def none_of(key: str, option: Any, options: Sequence[str]) -> ConfigError:
    """A group has no such option; the nearest are suggested."""
    near = did_you_mean([f"{key}={name}" for name in similar(str(option), options)])
    return ConfigError(key, f"{'null' if option is None else repr(option)} is none of {listed(options)}{near}")


def is_schema(option: str) -> bool:
    """Whether an option of a group holds names and types only."""
    return option == "schema" or option.endswith("_schema")


class Groups:
    """The groups of a program, in all folders that Hydra searches.

    Args:
        loader: Hydra's.
        name: of the primary configuration.

    Attributes:
        names: of all groups.
        defaults: groups as an override names them (`planner@baseline`), and their default options.
    """

    def __init__(self, loader: ConfigLoader, name: str):
        self.loader, self.name, self.names = loader, name, loader.list_groups("")
        primary = self.load(name)
        assert primary is not None
        entries = [entry for entry in primary.defaults if isinstance(entry, DictConfig)]
        pairs = [(str(group), str(option)) for entry in entries for group, option in entry.items()]
        self.defaults = {group: option for group, option in pairs if not group.startswith("override ")}

    def options(self, group: str) -> list[str]:
        """What may be chosen in a group, the user's own files too."""
        return [option for option in self.loader.get_group_options(group.partition("@")[0]) if not is_schema(option)]

    def load(self, path: str) -> DictConfig | None:
        """A YAML file of any folder that Hydra searches, its defaults list included; None if there is none.

        Raises:
            ConfigError: it is no YAML.
        """
        found = self._found(path)
        return found.config if found and isinstance(found.config, DictConfig) else None

    def is_global(self, path: str) -> bool:
        """Whether the keys of a file are those of the whole configuration, not of its group's section."""
        found = self._found(path)
        return found is not None and found.header.get("package") == "_global_"

    def _found(self, path: str) -> ConfigResult | None:
        for source in self.loader.get_sources():
            if source.scheme() != "structured" and source.is_config(path):
                try:
                    return source.load_config(path)
                except YAMLError as error:
                    text = " ".join(str(error).split())
                    raise ConfigError(path.rpartition("/")[0] or path, f"{path}.yaml cannot be read: {text}") from None
        return None

    def holders(self, key: str) -> list[str]:
        """Options, such as `planner=pd`, whose files set a key."""
        section, _, leaf = key.partition(".")
        found = []
        for entry in self.defaults:
            group, _, package = entry.partition("@")
            if (package or group) == section and leaf:
                files = {option: self.load(f"{group}/{option}") for option in self.options(group)}
                found += [f"{entry}={option}" for option, file in files.items() if file is not None and leaf in file]
        return found

    def split(self, words: Sequence[str]) -> tuple[list[str], list[Override]]:
        """The words that choose files, and overrides of values, of a command line.

        Raises:
            ConfigError: a word cannot be read, or asks for a group or option that is not there, or for a deletion.
        """
        overrides = [parsed(word) for word in words]
        # Files of a search path that is itself overridden are Hydra's to find.
        searched = [word for word in words if word.startswith("hydra.searchpath=")]
        groups = self.loader.get_group_options("", ObjectType.GROUP, self.name, searched) if searched else self.names
        choices, values = [], []
        for word, override in zip(words, overrides, strict=True):
            key = override.key_or_group
            if section_of(key) != "hydra" and not searched:
                self._check(override)
            if key in groups or "/" in key or override.is_delete() or key == "hydra.searchpath":
                choices.append(word)
            else:
                values.append(override)
        return choices, values

    def _check(self, override: Override) -> None:
        key = override.key_or_group
        if override.is_sweep_override():
            line = f"{_text(override)} is a sweep over several values"
            raise ConfigError(key, f"{line}; add --multirun to run each, or brackets if it is one list")
        packages = {group.partition("@")[2]: group for group in self.defaults if "@" in group}
        if key in self.names:
            self._check_choice(override)
        elif override.package is not None:
            near = did_you_mean(similar(key, self.defaults))
            raise ConfigError(key, f"no such group{near} (there are {listed(self.defaults)})")
        elif override.is_delete():
            raise ConfigError(key, f"cannot be deleted, every run needs it; set it with {key}=VALUE")
        elif key in packages:
            raise ConfigError(key, f"is a group of settings; choose it with {packages[key]}={override.value()}")

    def _check_choice(self, override: Override) -> None:
        group = override.key_or_group
        key = f"{group}@{override.package}" if override.package else group
        ours = [known for known in self.defaults if known.partition("@")[0] == group]
        if key not in self.defaults and (ours or override.package is not None or not override.is_add()):
            near = did_you_mean(ours or similar(key, self.defaults))
            raise ConfigError(key, f"is no group to choose from here{near} (there are {listed(self.defaults)})")
        there = self.options(group)
        if override.is_delete():
            instead = f"{key}=none" if "none" in there else f"one of {key}={listed(there)}"
            raise ConfigError(key, f"cannot be left out; choose {instead}")
        value: Any = override.value()
        if key in self.defaults and (override.is_add() or override.is_force_add()):
            raise ConfigError(key, f"is chosen already; drop the +, as in {key}={value}")
        if isinstance(value, list):
            raise ConfigError(key, f"takes one option, got the list {_text(override)}")
        if value not in there or self.load(f"{group}/{value}") is None:
            raise none_of(key, value, there)


def _text(override: Override) -> str:
    """The value as it was written."""
    return (override.input_line or "").partition("=")[2]
