"""An ablation must hold: where another override undoes what it declares, the table it stands in would lie."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uwirl.config.checks import ConfigError
from uwirl.config.groups import Groups


def check_ablation(config: DictConfig, choices: Mapping[str, Any], groups: Groups) -> None:
    """Compare what the chosen ablation's file declares with what was composed.

    Args:
        config: composed.
        choices: Hydra's, option by group.
        groups: that find the files, the user's own too.

    Raises:
        ConfigError: a value or a group's option is another; names ablation, key and both values.
    """
    ablation = choices.get("ablation")
    for key, wanted in _declared(f"ablation/{ablation}", groups) if ablation else ():
        group = key.removeprefix("/")
        found = choices.get(group) if key.startswith("/") else OmegaConf.select(config, key)
        found = OmegaConf.to_container(found) if OmegaConf.is_config(found) else found
        if found != wanted:
            problem = f"{found!r} undoes ablation={ablation}, which sets {wanted!r}; drop one of the two"
            raise ConfigError(group, problem)


def _declared(path: str, groups: Groups) -> Iterator[tuple[str, Any]]:
    """What a file of an ablation sets: `/group` and option for groups, dotted key and value for values."""
    values: Any = OmegaConf.to_container(groups.load(path) or OmegaConf.create())
    for entry in values.pop("defaults", []):
        if isinstance(entry, dict):
            ((group, option),) = entry.items()
            group = str(group).removeprefix("override ").strip().removeprefix("/")
            yield f"/{group}", option
            # Of an option its name: `estimator.name` would else undo `estimator`.
            folder, _, package = group.partition("@")
            file = groups.load(f"{folder}/{option}")
            if file is not None and "name" in file:
                yield f"{package or folder}.name", file["name"]
        elif entry != "_self_" and not str(entry).startswith("/"):
            yield from _declared(f"{path.rpartition('/')[0]}/{entry}", groups)
    yield from _leaves(values)


def _leaves(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}.")
        # An interpolation declares a rule, not a value.
        elif not (isinstance(value, str) and "${" in value):
            yield f"{prefix}{name}", value
