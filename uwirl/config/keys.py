"""Which keys there are and what may stand there, by the schemas; what does not fit is refused in one message."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

from omegaconf import MISSING, BooleanNode, DictConfig, FloatNode, IntegerNode, ListConfig, OmegaConf, StringNode
from omegaconf.errors import ValidationError

from uwirl.config.checks import ConfigError, unlike
from uwirl.config.suggestions import did_you_mean, listed, nearest_keys, similar

WORDS = {int: "whole number", float: "number", bool: "true or false", str: "text"}
NODES: dict[Any, Any] = {int: IntegerNode, float: FloatNode, bool: BooleanNode, str: StringNode}
# Sections that are null until an experiment fills them.
FILLED_BY = {"scenario.layouts": "experiment=random_layouts"}


@cache
def field_types(schema: type) -> dict[str, Any]:
    """Types of a schema's fields, inherited ones too."""
    hints = typing.get_type_hints(schema)
    return {field.name: hints[field.name] for field in dataclasses.fields(schema)}


def required(annotation: Any) -> tuple[Any, bool]:
    """A type without its null, and whether it had one."""
    options = typing.get_args(annotation)
    if type(None) in options:
        return next(option for option in options if option is not type(None)), True
    return annotation, annotation is Any


def words(annotation: Any) -> str:
    """A type as a user would say it."""
    wanted, optional = required(annotation)
    if optional and wanted is not Any:
        return f"{words(wanted)}, or null"
    if dataclasses.is_dataclass(wanted):
        return "group of settings"
    if isinstance(wanted, type) and issubclass(wanted, Enum):
        return "name"
    if typing.get_origin(wanted) is list:
        items = words(typing.get_args(wanted)[0]).replace("group of settings", "groups of setting")
        return "list" if items == "any" else f"list of {items}s"
    return "names and values" if typing.get_origin(wanted) is dict else WORDS.get(wanted, "any")


@dataclass(frozen=True)
class Keys:
    """The keys of a configuration.

    Attributes:
        schemas: by section, "" for the whole; of other sections those of the fields.
        config: composed, if it could be.
        groups: names of groups, which are no keys but may have been meant.
        holders: other options that have a key, such as `planner=pd`.
        added: whether keys may be new where any name will do.
        where: what is checked stands, such as the file.
    """

    schemas: Mapping[str, Any]
    config: DictConfig | None = None
    groups: Sequence[str] = ()
    holders: Callable[[str], Sequence[str]] = lambda key: ()
    added: bool = False
    where: str = ""

    @classmethod
    def of(cls, config: DictConfig, *rest: Any) -> Keys:
        """Those of a composed configuration, whose sections tell their schemas."""
        sections = {str(name): OmegaConf.get_type(config, str(name)) for name in config if name != "hydra"}
        schemas = {name: schema for name, schema in sections.items() if dataclasses.is_dataclass(schema)}
        return cls({"": OmegaConf.get_type(config), **schemas}, config, *rest)

    def check(self, value: Any, annotation: Any = Any, key: str = "", node: Any = None) -> None:
        """Refuse what no schema has, and values of another type.

        Args:
            value: plain; what is missing or refers to something else is not looked at. Entries of a list may stand in a
                dictionary, by their numbers.
            annotation: the type that it should have.
            key: dotted.
            node: what stands there in the composed configuration.

        Raises:
            ConfigError: the first that does not fit.
        """
        wanted, optional = required(annotation)
        schema = OmegaConf.get_type(node) if isinstance(node, DictConfig) else None
        wanted = schema if dataclasses.is_dataclass(schema) else self.schemas.get(key, wanted)
        if isinstance(value, str) and (value == MISSING or "${" in value):
            self._check_reference(wanted, key)
        elif value is None and optional:
            pass
        elif dataclasses.is_dataclass(wanted):
            self._check_section(value, wanted, key, node)
        elif isinstance(value, dict) and isinstance(node, ListConfig):
            for i, part in value.items():
                if not str(i).isdigit() or int(i) >= len(node):
                    entries = f"{len(node)} entries" if isinstance(part, dict) else "entries"
                    raise ConfigError(f"{key}.{i}", f"is beyond the list's {entries}; set the whole list")
                self._check_item(part, wanted, f"{key}.{i}", _child(node, int(i)))
        elif isinstance(value, list) and typing.get_origin(wanted) is list:
            for i, part in enumerate(value):
                self._check_item(part, wanted, f"{key}.{i}" if typing.get_args(wanted)[0] in NODES else key)
        elif isinstance(value, dict) and (wanted is Any or typing.get_origin(wanted) is dict):
            for name, part in value.items():
                if isinstance(node, DictConfig) and name not in node and not self.added:
                    inner = f"{key}.{name}"
                    raise ConfigError(inner, f"is not there yet; add it with a +, as in +{inner}=VALUE")
                self.check(part, Any, f"{key}.{name}", _child(node, name))
        elif isinstance(value, dict):
            inner = ".".join((key, *_path(value)))
            raise ConfigError(inner, f"no such key: {key} is no group of settings, it must be a {words(annotation)}")
        else:
            self._check_value(value, annotation, key)

    def _check_section(self, value: Any, schema: Any, key: str, node: Any) -> None:
        if not isinstance(value, dict):
            problem = "is a group of settings, which takes no single value; set"
            raise ConfigError(key, f"{problem} {key}.KEY=VALUE{self.where}")
        if self.config is not None and node is None and key in FILLED_BY:
            raise ConfigError(key, f"is null here, so none of it can be set; {FILLED_BY[key]} fills it")
        known = field_types(schema)
        for name, part in value.items():
            inner = f"{key}.{name}" if key else str(name)
            if name not in known and inner != "hydra" and not (self.added and inner.startswith("hydra.")):
                raise self._unknown(inner, list(known), _path(part))
            # Of single values the type says all.
            child = _child(node, name) if isinstance(part, (dict, list)) else None
            self.check(part, known.get(name, Any), inner, child)

    def _check_item(self, value: Any, annotation: Any, key: str, node: Any = None) -> None:
        (item,) = typing.get_args(annotation) or (Any,)
        inner = isinstance(value, (dict, list))
        if item in NODES and (inner or not _fits(value, item)):
            problem = "which holds no lists or keys" if inner else f"got {value!r}"
            raise ConfigError(key, f"is an entry of a {words(annotation)}, {problem}{self.where}")
        self.check(value, item, key, node)

    def _check_value(self, value: Any, annotation: Any, key: str) -> None:
        wanted, _ = required(annotation)
        problem = None
        if isinstance(wanted, type) and issubclass(wanted, Enum) and isinstance(value, str):
            problem = unlike(value, wanted.__members__)
        elif not (wanted is Any or _fits(value, wanted)):
            got = "" if self.where else f", got {'null' if value is None else str(value) or 'nothing'}"
            problem = f"must be {'' if wanted is bool else 'a '}{words(annotation)}{got}"
        if problem:
            raise ConfigError(key, problem + self.where)

    def _check_reference(self, wanted: Any, key: str) -> None:
        """OmegaConf takes any value for a section that is an interpolation."""
        if self.config is not None and (dataclasses.is_dataclass(wanted) or typing.get_origin(wanted) is list):
            value = OmegaConf.select(self.config, key, throw_on_resolution_failure=False)
            if not (value is None or OmegaConf.is_config(value)):
                raise ConfigError(key, f"must be a {words(wanted)}, but refers to {value!r}")

    def _unknown(self, key: str, siblings: list[str], rest: Sequence[str]) -> ConfigError:
        """A key that no schema has; `rest` stands behind it on the command line."""
        section = key.rpartition(".")[0]
        siblings = list(dict.fromkeys([*siblings, *([] if section else self.groups)]))
        # What says little about a section comes last.
        siblings.sort(key=lambda name: name in ("target", "settings"))
        everywhere = list(self.all())
        others = [] if self.where else self.holders(key)
        where = self.where or (f" here, only with {' or '.join(others)}" if others else "")
        near = nearest_keys(key, siblings, everywhere)
        if rest and not self.added:
            # The section may be misspelt, and the rest of the key be right.
            whole = [".".join((other, *rest)) for other in similar(key, siblings)]
            right = [other for other in whole if other in everywhere]
            key, near = (".".join((key, *rest)), right) if right else (key, near)
        has = f"{section} has" if section else "there are"
        return ConfigError(key, f"no such key{where}{did_you_mean(near)} ({has} {listed(siblings)})")

    def all(self, section: str = "", schema: Any = None) -> Iterator[str]:
        """Every dotted key; lists, and names that are free to choose, count as one."""
        for name, annotation in field_types(schema or self.schemas[section]).items():
            key = f"{section}.{name}" if section else name
            inner = self.schemas.get(key, required(annotation)[0])
            if dataclasses.is_dataclass(inner):
                yield from self.all(key, inner)
            else:
                yield key


def _path(value: Any) -> list[str]:
    """The keys of dictionaries with one entry each."""
    if isinstance(value, dict) and len(value) == 1:
        ((name, inner),) = value.items()
        return [str(name), *_path(inner)]
    return []


def _fits(value: Any, wanted: Any) -> bool:
    """Whether OmegaConf takes a single value for a number or a text; what refers to another one is not looked at."""
    try:
        return wanted in NODES and ("${" in str(value) or NODES[wanted](value, is_optional=False) is not None)
    except ValidationError:
        return False


def _child(node: Any, name: Any) -> Any:
    """What stands there, None if it is missing, refers to something else or is yet to come."""
    if not OmegaConf.is_config(node) or (isinstance(node, DictConfig) and name not in node):
        return None
    return None if OmegaConf.is_missing(node, name) or OmegaConf.is_interpolation(node, name) else node[name]
