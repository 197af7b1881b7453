"""What the schemas say about each key: its type in words, and the comment behind it. Read for messages and for docs."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import tokenize
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from omegaconf import MISSING, DictConfig

WORDS = {int: "whole number", float: "number", bool: "true or false", str: "text"}


@dataclass(frozen=True)
class Setting:
    """One field of a schema.

    Attributes:
        key: within its section, with dots where schemas are nested; `[]` after a list of them.
        type: in words.
        comment: behind the field, or above it.
        default: the schema's own, `...` where only YAML files give one.
    """

    key: str
    type: str
    comment: str
    default: Any = ...


def is_schema(option: str) -> bool:
    """Whether an option of a group holds names and types only."""
    return option == "schema" or option.endswith("_schema")


def words(annotation: Any) -> str:
    """A type as a user would say it."""
    options = typing.get_args(annotation)
    if type(None) in options:
        (rest,) = (option for option in options if option is not type(None))
        return f"{words(rest)}, or null"
    if dataclasses.is_dataclass(annotation):
        return "group of settings"
    if typing.get_origin(annotation) is list:
        items = words(options[0]).replace("group of settings", "groups of setting")
        return "list" if items == "any" else f"list of {items}s"
    if typing.get_origin(annotation) is dict:
        return "names and values"
    return WORDS.get(annotation, "any")


@cache
def field_types(schema: type) -> dict[str, Any]:
    """Types of a schema's fields, inherited ones too."""
    return typing.get_type_hints(schema)


def nested(annotation: Any) -> type | None:
    """The schema that a field holds, perhaps in a list or optionally, if it holds one."""
    for option in (annotation, *typing.get_args(annotation)):
        if isinstance(option, type) and dataclasses.is_dataclass(option) and not isinstance(option, types.GenericAlias):
            return option
    return None


@cache
def settings(schema: type) -> tuple[Setting, ...]:
    """Every key of a schema, those of nested schemas after the field that holds them."""
    found: list[Setting] = []
    for field in dataclasses.fields(schema):
        annotation = field_types(schema)[field.name]
        owner = next(c for c in reversed(schema.__mro__) if field.name in vars(c).get("__annotations__", {}))
        comment = _comments(owner).get(field.name, "")
        found.append(Setting(field.name, words(annotation), comment, _default(field)))
        inner = nested(annotation)
        if inner is not None:
            several = "[]" if typing.get_origin(annotation) is list else ""
            found += [dataclasses.replace(s, key=f"{field.name}{several}.{s.key}") for s in settings(inner)]
    return tuple(found)


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
        return ... if dataclasses.is_dataclass(value) else value
    return ... if field.default in (dataclasses.MISSING, MISSING) else field.default


@cache
def _comments(schema: type) -> dict[str, str]:
    """The comment behind each field of a class, or else those on the lines directly above it."""
    source = inspect.getsource(schema)
    comments = {
        token.start[0]: (token.string.removeprefix("#").strip(), token.start[1], token.line[: token.start[1]].strip())
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    found: dict[str, str] = {}
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    for node in body.body:
        if not (isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)):
            continue
        lines: list[str] = []
        line = node.end_lineno or node.lineno
        if line in comments:
            lines = [comments[line][0]]
        else:
            line = node.lineno - 1
            # A comment behind another field is that field's own.
            while line in comments and not comments[line][2]:
                lines.insert(0, comments[line][0])
                line -= 1
        found[node.target.id] = " ".join(lines)
    return found


def keys(config: DictConfig, prefix: str = "") -> Iterator[str]:
    """Dotted names of every leaf of a composed configuration; lists are leaves."""
    for name in map(str, config):
        child = config._get_node(name)
        if isinstance(child, DictConfig) and not (child._is_none() or child._is_missing() or child._is_interpolation()):
            yield from keys(child, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"
