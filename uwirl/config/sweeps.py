"""The jobs of a multirun that show whether its keys and types are right, before any of them runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import hydra
from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep
from omegaconf import DictConfig

from uwirl.config.checks import ConfigError, one_of
from uwirl.config.compose import REFUSALS, searching
from uwirl.config.groups import parsed
from uwirl.config.overrides import section_of
from uwirl.config.suggestions import explained


def space(name: str, words: Sequence[str], config_dir: str | None = None) -> list[str]:
    """What the chosen sweeper varies or sets by itself, as words that may stand before those of the command line.

    Args:
        name: of the primary configuration, whose schema is registered.
        words: the command line; what it sets is not the sweeper's.
        config_dir: a folder of the user's own files.

    Raises:
        ConfigError: the sweeper is not there or not installed, or a setting of it is impossible.
    """
    given = {parsed(word).key_or_group: word for word in words}
    own = [word for key, word in given.items() if section_of(key) == "hydra"]
    if not own:
        return []
    for key in given:
        setting = key.removeprefix("hydra.sweeper.params.")
        if setting != key:
            raise ConfigError(key, f"is for files; here write the setting itself, {setting}=VALUES")
    with searching(config_dir):
        try:
            sweeper = hydra.compose(name, own, return_hydra_config=True).hydra.sweeper
        except REFUSALS as error:
            raise explained(error, own) from None
    params = {str(key): f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()}
    if "seeds" in sweeper:
        check_search(sweeper)
        if "seed" in given or "seed" in params:
            raise ConfigError("seed", "of a search is set for each trial; choose with hydra.sweeper.seeds=[0,1,2]")
    return [word for key, word in params.items() if key not in given]


def check_search(sweeper: DictConfig) -> None:
    """Rules of the settings that every search has.

    Raises:
        ConfigError: the first that is broken.
    """
    seeds = list(sweeper.seeds)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ConfigError("hydra.sweeper.seeds", f"needs one or more different seeds, got {seeds}")
    for key in ("n_trials", "n_jobs"):
        if sweeper[key] < 1:
            raise ConfigError(f"hydra.sweeper.{key}", f"must be at least 1, got {sweeper[key]}")
    one_of(sweeper.direction, "hydra.sweeper.direction", ("minimize", "maximize"))


def samples(words: Sequence[str], loader: ConfigLoader) -> Iterator[list[str]]:
    """Jobs of a sweep: the first, and for every other value that may be of another type the one with it alone.

    Args:
        words: the command line, with sweeps.
        loader: that knows the options of groups, for those written as glob(...).

    Raises:
        ConfigError: a word cannot be read.
    """
    alternatives = [_alternatives(word, loader) for word in words]
    first = [values[0] for values in alternatives]
    yield first
    for i, values in enumerate(alternatives):
        for other in values[1:]:
            yield [*first[:i], other, *first[i + 1 :]]


def _alternatives(word: str, loader: ConfigLoader) -> list[str]:
    parsed(word)
    (override,) = OverridesParser.create(config_loader=loader).parse_overrides([word])
    if not override.is_sweep_override():
        return [word]
    key = word.partition("=")[0]
    interval = override.value()
    if isinstance(interval, IntervalSweep):
        return [f"{key}={interval.start}", f"{key}={interval.end}"]
    values = [f"{key}={value}" for value in override.sweep_string_iterator()]
    if override.key_or_group in loader.list_groups(""):
        return values or [word]
    # Whether a number is accepted does not depend on which number.
    return list({_kind(value): value for value in reversed(values)}.values())[::-1] or [word]


def _kind(word: str) -> object:
    value = OverridesParser.create().parse_override(word).value()
    return type(value) if isinstance(value, (int, float, str)) else word
