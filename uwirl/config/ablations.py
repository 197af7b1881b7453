"""What is chosen must hold: an ablation against all others, a group's option against the values of an experiment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf

from uwirl.config.checks import ConfigError
from uwirl.config.groups import Groups
from uwirl.config.overrides import key_of


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


def check_experiment(choices: Mapping[str, Any], groups: Groups, words: Sequence[str]) -> None:
    """Compare the options that a command line names with the values that its experiment sets in their place.

    Args:
        choices: Hydra's, option by group.
        groups: that find the files, the user's own too.
        words: the command line, whose own values replace both, as those of an ablation do.

    Raises:
        ConfigError: a value of a named option is replaced by the experiment's.
    """
    named = set(map(key_of, words))
    experiment = choices.get("experiment")
    theirs = dict(_declared(f"experiment/{experiment}", groups)) if experiment else {}
    after = named | dict(_declared(f"ablation/{choices['ablation']}", groups)).keys() if experiment else named
    for group in sorted(named & groups.defaults.keys() - {"experiment", "ablation"}):
        option = choices.get(group)
        if theirs.get(f"/{group}") == option:
            # That one the experiment was made for.
            continue
        folder, _, package = group.partition("@")
        prefix = "" if groups.is_global(f"{folder}/{option}") else f"{package or folder}."
        for key, value in _declared(f"{folder}/{option}", groups):
            key = prefix + key
            if theirs.get(key, value) != value and not any(name == key or name.startswith(f"{key}.") for name in after):
                problem = (
                    f"{key} of {group}={option} is replaced by experiment={experiment}, which sets {theirs[key]!r}"
                )
                raise ConfigError(group, f"{problem}; choose experiment=none, or say which with {key}=VALUE")


def _declared(path: str, groups: Groups) -> Iterator[tuple[str, Any]]:
    """What a file sets: `/group` and option for groups, dotted key and value for values."""
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
