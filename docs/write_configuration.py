"""Writes configuration.md, beside it, from the schemas and the comments in them.

python docs/write_configuration.py
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import math
import tokenize
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from uwirl.config import estimate_schema
from uwirl.config.compose import compose, composed, searching
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.groups import Groups, is_schema
from uwirl.config.keys import field_types, required, words
from uwirl.config.schema import Config, SearchConfig

PATH = Path(__file__).with_name("configuration.md")
INTRODUCTION = """\
# Configuration

<!-- Written by `python docs/write_configuration.py`; do not edit. -->

Every setting of `uwirl`, by group: `uwirl GROUP=OPTION` chooses among the files of `conf/GROUP`, `uwirl KEY=VALUE` sets
one value. Defaults are those of `uwirl` without arguments, options in bold; in a table for other options, those of the
first. A typo, a wrong type or an impossible value is answered before anything runs.
"""
SEARCH = """\
## Searches

`uwirl -m hydra/sweeper=OPTION`, with the extra `optuna` ([sweeps.md](sweeps.md)). Options: {spaces}
"""
ESTIMATE = """\
## uwirl-estimate

Groups: {groups}, as above. Of the channel it uses noise, bandwidth and absorption only, of logging `figures`.
"""
ABLATIONS = """\
## Experiments and ablations

They set values of several groups, and come after them: `experiment` says what is run, `ablation` which one factor is
changed. An ablation that another override undoes is refused.

- `experiment`: {experiments}
- `ablation`: {ablations}
"""


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


@cache
def settings(schema: type) -> tuple[Setting, ...]:
    """Every key of a schema, those of nested schemas after the field that holds them."""
    found: list[Setting] = []
    for field in dataclasses.fields(schema):
        annotation = field_types(schema)[field.name]
        owners = [c for c in schema.__mro__ if field.name in vars(c).get("__annotations__", {})]
        comment = next(filter(None, (_comments(owner).get(field.name) for owner in owners)), "")
        found.append(Setting(field.name, _type(annotation), comment, _default(field)))
        inner = _nested(annotation)
        if inner is not None:
            several = "[]" if typing.get_origin(annotation) is list else ""
            found += [dataclasses.replace(s, key=f"{field.name}{several}.{s.key}") for s in settings(inner)]
    return tuple(found)


def _nested(annotation: Any) -> type | None:
    """The schema that a field holds, perhaps in a list or optionally, if it holds one."""
    wanted, _ = required(annotation)
    (inner,) = typing.get_args(wanted) if typing.get_origin(wanted) is list else (wanted,)
    return inner if isinstance(inner, type) and dataclasses.is_dataclass(inner) else None


def _type(annotation: Any) -> str:
    """A type in words, names that are choices one by one."""
    (inner,) = typing.get_args(annotation) if typing.get_origin(annotation) is list else (annotation,)
    if not (isinstance(inner, type) and issubclass(inner, Enum)):
        return words(annotation)
    return f"{'list of' if inner is not annotation else 'one of'} {', '.join(inner.__members__)}"


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


def document() -> str:
    """The whole page."""
    estimate_schema.register()
    defaults = dataclasses.asdict(compose())
    with searching() as loader:
        groups = Groups(loader, "config")
        parts = [INTRODUCTION, "Outside groups:\n", _outside(groups, defaults, Config)]
        for group in (g for g in groups.defaults if "@" not in g and g in field_types(Config)):
            parts += _group(groups, group, defaults)
        experiments, ablations = (_options(groups, group) for group in ("experiment", "ablation"))
        parts.append(ABLATIONS.format(experiments=experiments, ablations=ablations))
        # Those of plugins, installed or not, are no files of ours.
        spaces = [name for name in groups.options("hydra/sweeper") if groups.load(f"hydra/sweeper/{name}")]
        parts.append(SEARCH.format(spaces=_listed(spaces, "")))
        rows = [setting for setting in settings(SearchConfig) if setting.key != "_target_"]
        parts.append(_table(rows, "hydra.sweeper", _plain(groups.load("hydra/sweeper/search"))))
        groups = Groups(loader, "estimate")
        names = ", ".join(f"`{group}` (**{option}**)" for group, option in groups.defaults.items())
        parts.append(ESTIMATE.format(groups=names))
    # Its log has no default, so it cannot be made an object.
    parts.append(_outside(groups, _plain(composed("estimate", [])), EstimateConfig))
    return "\n".join(parts)


def _outside(groups: Groups, defaults: Mapping[str, Any], schema: type) -> str:
    """Keys that belong to no group."""
    sections = {part for group in groups.defaults for part in group.split("@")}
    return _table([s for s in settings(schema) if s.key.partition(".")[0] not in sections], "", defaults)


def _group(groups: Groups, group: str, defaults: Mapping[str, Any]) -> Iterator[str]:
    """A group's keys: those of all its options, then those of some."""
    base = field_types(Config)[group]
    purpose = next(s.comment for s in settings(Config) if s.key == group)
    yield f"## {group}\n\n{purpose[0].upper()}{purpose[1:]}. Options: {_options(groups, group)}\n"
    if group == "planner":
        yield "`planner@baseline` takes the same options; its keys begin with `baseline`.\n"
    shared = settings(base)
    yield _table(shared, group, defaults[group])
    known = {setting.key for setting in shared}
    holders: dict[tuple[Setting, ...], list[str]] = {}
    for option in groups.options(group):
        rest = tuple(s for s in settings(_schema(groups, group, option)) if s.key not in known)
        holders.setdefault(rest, []).append(option)
    for rest, names in holders.items():
        if rest:
            # The default option's values are those of the main configuration.
            first = groups.defaults[group] in names
            values = defaults[group] if first else _plain(groups.load(f"{group}/{names[0]}"))
            yield f"With {' or '.join(f'`{group}={name}`' for name in names)}:\n"
            yield _table(rest, group, values)


def _schema(groups: Groups, group: str, option: str) -> type:
    """The dataclass that an option's defaults list names, perhaps by way of another option, or else the group's."""
    file = groups.load(f"{group}/{option}")
    assert file is not None
    for entry in map(str, file.get("defaults", [])):
        name = entry.partition("@")[0].rpartition("/")[2]
        if is_schema(name):
            return OmegaConf.get_type(ConfigStore.instance().load(f"{group}/{name}.yaml").node)  # type: ignore[return-value]
        if name != "_self_":
            return _schema(groups, group, name)
    return field_types(Config)[group]


def _plain(config: DictConfig | None) -> Mapping[str, Any]:
    values: Any = OmegaConf.to_container(config) if config is not None else {}
    return values


def _table(rows: Sequence[Setting], prefix: str, values: Mapping[str, Any]) -> str:
    lines = ["| key | type | default | unit and meaning |", "|---|---|---|---|"]
    for row in rows:
        key = f"{prefix}.{row.key}" if prefix else row.key
        meaning = row.comment.replace("|", "\\|")
        value = _at(values, row.key)
        lines.append(f"| `{key}` | {row.type} | {_said(row.default if value is ... else value)} | {meaning} |")
    return "\n".join(lines) + "\n"


def _at(values: Any, key: str) -> Any:
    """A value by its dotted key; `...` for sections, and what stands in none."""
    for name in key.split("."):
        if not isinstance(values, Mapping) or name not in values:
            return ...
        values = values[name]
    return ... if isinstance(values, Mapping) else values


def _said(value: Any) -> str:
    """As YAML writes it."""
    return "" if value is ... else f"`{_yaml(value)}`"


def _yaml(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_yaml(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, float) and math.isinf(value):
        return ".inf" if value > 0.0 else "-.inf"
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _options(groups: Groups, group: str) -> str:
    return _listed(groups.options(group), groups.defaults[group])


def _listed(names: Sequence[str], default: str) -> str:
    return ", ".join(f"**{name}**" if name == default else name for name in names) + "."


if __name__ == "__main__":
    PATH.write_text(document(), encoding="utf-8")
