"""`python -m uwirl.config.document` writes docs/configuration.md from the schemas and the comments in them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from uwirl.config import estimate_schema
from uwirl.config.catalogue import Setting, field_types, is_schema, settings
from uwirl.config.compose import compose, composed, folder, searching
from uwirl.config.estimate_schema import EstimateConfig
from uwirl.config.groups import chosen, load, options
from uwirl.config.schema import Config
from uwirl.config.search_schema import SearchConfig

PATH = folder().parent / "docs" / "configuration.md"
INTRODUCTION = """\
# Configuration

<!-- Written by `python -m uwirl.config.document`; do not edit. -->

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


def document() -> str:
    """The whole page."""
    defaults = dataclasses.asdict(compose())
    estimate_schema.register()
    with searching() as loader:
        groups = chosen(loader, "config")
        parts = [INTRODUCTION, "Outside groups:\n", _outside(groups, defaults, Config)]
        for group in (g for g in groups if "@" not in g and g in field_types(Config)):
            parts += _group(loader, group, groups[group], defaults)
        experiments, ablations = (_listed(options(loader, g), groups[g]) for g in ("experiment", "ablation"))
        parts.append(ABLATIONS.format(experiments=experiments, ablations=ablations))
        # Those of plugins, installed or not, are no files of ours.
        spaces = [name for name in options(loader, "hydra/sweeper") if load(loader, f"hydra/sweeper/{name}")]
        parts.append(SEARCH.format(spaces=_listed(spaces, "")))
        rows = [setting for setting in settings(SearchConfig) if setting.key != "_target_"]
        parts.append(_table(rows, "hydra.sweeper", _plain(load(loader, "hydra/sweeper/search"))))
        groups = chosen(loader, "estimate")
        names = ", ".join(f"`{group}` (**{option}**)" for group, option in groups.items())
        parts.append(ESTIMATE.format(groups=names))
    # Its log has no default, so it cannot be made an object.
    parts.append(_outside(groups, _plain(composed("estimate", [])), EstimateConfig))
    return "\n".join(parts)


def _outside(groups: Mapping[str, str], defaults: Mapping[str, Any], schema: type) -> str:
    """Keys that belong to no group."""
    sections = {part for group in groups for part in group.split("@")}
    return _table([s for s in settings(schema) if s.key.partition(".")[0] not in sections], "", defaults)


def _group(loader: ConfigLoader, group: str, default: str, defaults: Mapping[str, Any]) -> Iterator[str]:
    """A group's keys: those of all its options, then those of some."""
    base = field_types(Config)[group]
    purpose = next(s.comment for s in settings(Config) if s.key == group)
    yield f"## {group}\n\n{purpose[0].upper()}{purpose[1:]}. Options: {_listed(options(loader, group), default)}\n"
    if group == "planner":
        yield "`planner@baseline` takes the same options; its keys begin with `baseline`.\n"
    shared = settings(base)
    yield _table(shared, group, defaults[group])
    schemas: dict[type, list[str]] = {}
    for option in options(loader, group):
        schemas.setdefault(_schema(loader, group, option), []).append(option)
    for schema, names in schemas.items():
        rest = [setting for setting in settings(schema) if setting not in shared]
        if rest:
            # The default option's values are those of the main configuration.
            values = defaults[group] if default in names else _plain(load(loader, f"{group}/{names[0]}"))
            yield f"With {' or '.join(f'`{group}={name}`' for name in names)}:\n"
            yield _table(rest, group, values)


def _schema(loader: ConfigLoader, group: str, option: str) -> type:
    """The dataclass that an option's defaults list names, perhaps by way of another option, or else the group's."""
    file = load(loader, f"{group}/{option}")
    assert file is not None
    for entry in map(str, file.get("defaults", [])):
        name = entry.partition("@")[0].rpartition("/")[2]
        if is_schema(name):
            return OmegaConf.get_type(ConfigStore.instance().load(f"{group}/{name}.yaml").node)  # type: ignore[return-value]
        if name != "_self_":
            return _schema(loader, group, name)
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


def _listed(names: Sequence[str], default: str) -> str:
    return ", ".join(f"**{name}**" if name == default else name for name in names) + "."


def main(path: Path = PATH) -> None:
    """Write the page."""
    path.write_text(document(), encoding="utf-8")


if __name__ == "__main__":
    main()
