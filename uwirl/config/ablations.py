"""An ablation must hold: where another override undoes what it declares, the table it stands in would lie."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hydra.core.config_loader import ConfigLoader
from omegaconf import DictConfig, OmegaConf

from uwirl.config.checks import ConfigError
from uwirl.config.groups import load


def check_ablation(config: DictConfig, choices: Mapping[str, Any], loader: ConfigLoader) -> None:
    """Compare what the chosen ablation's file declares with what was composed.

    Args:
        config: composed.
        choices: Hydra's, option by group.
        loader: that finds the files, the user's own too.

    Raises:
        ConfigError: a value or a group's option is another; names ablation, key and both values.
    """
    ablation = choices.get("ablation")
    if ablation is None:
        return
    for key, wanted in declared(loader, f"ablation/{ablation}"):
        group = key.removeprefix("/")
        found = choices.get(group) if key.startswith("/") else _value(config, key)
        if found != wanted:
            problem = f"{found!r} undoes ablation={ablation}, which sets {wanted!r}; drop one of the two"
            raise ConfigError(group, problem)


def declared(loader: ConfigLoader, path: str) -> Iterator[tuple[str, Any]]:
    """What a file of an ablation sets: `/group` and option for groups, dotted key and value for values."""
    file = load(loader, path)
    if file is None:
        return
    values = OmegaConf.to_container(file)
    assert isinstance(values, dict)
    for entry in values.pop("defaults", []):
        if isinstance(entry, dict):
            ((group, option),) = entry.items()
            group = str(group).removeprefix("override ").strip().removeprefix("/")
            yield f"/{group}", option
            yield from _own_name(loader, group, option)
        elif entry != "_self_" and not str(entry).startswith("/"):
            yield from declared(loader, f"{path.rpartition('/')[0]}/{entry}")
    yield from _leaves(values)


def _own_name(loader: ConfigLoader, group: str, option: str) -> Iterator[tuple[str, Any]]:
    """Of an option its name: `estimator.name` would else undo `estimator`."""
    folder, _, package = group.partition("@")
    file = load(loader, f"{folder}/{option}")
    if file is not None and "name" in file:
        yield f"{package or folder}.name", file["name"]


def _leaves(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}.")
        # An interpolation declares a rule, not a value.
        elif not (isinstance(value, str) and "${" in value):
            yield f"{prefix}{name}", value


def _value(config: DictConfig, key: str) -> Any:
    value = OmegaConf.select(config, key)
    return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
