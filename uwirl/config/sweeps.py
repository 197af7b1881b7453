"""The jobs of a multirun that show whether its keys and types are right, before any of them runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.types import IntervalSweep

from uwirl.config.checks import ConfigError
from uwirl.config.compose import composed, searching
from uwirl.config.groups import parsed
from uwirl.config.overrides import section_of
from uwirl.config.schema import SearchConfig


def check_jobs(name: str, words: Sequence[str], config_dir: str | None = None) -> None:
    """Refuse names and types, which are those of every job of a sweep; a job that breaks a rule fails alone.

    Args:
        name: of the primary configuration, whose schema is registered.
        words: the command line, with sweeps.
        config_dir: a folder of the user's own files.

    Raises:
        ConfigError: the first of them.
    """
    words = [*space(name, words, config_dir), *words]
    with searching(config_dir) as loader:
        jobs = list(samples(words, loader))
    for job in jobs:
        composed(name, job, config_dir, ablation=False)


def space(name: str, words: Sequence[str], config_dir: str | None = None) -> list[str]:
    """What the chosen sweeper varies or sets by itself, as words that may stand before those of the command line.

    Args:
        name, words, config_dir: as of `check_jobs`.

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
    sweeper = composed(name, own, config_dir, whole=True).hydra.sweeper
    params = {str(key): f"{key}={value}" for key, value in (sweeper.get("params") or {}).items()}
    if "seeds" in sweeper:
        ruled = {name: sweeper[name] for name in ("n_trials", "n_jobs", "direction")}
        SearchConfig(seeds=list(sweeper.seeds), **ruled).check("hydra.sweeper")
        if "seed" in given or "seed" in params:
            raise ConfigError("seed", "of a search is set for each trial; choose with hydra.sweeper.seeds=[0,1,2]")
    if "n_trials" in sweeper and not params and not any(parsed(word).is_sweep_override() for word in words):
        example = "add a setting with the values that it may have, such as 'planner.updates=range(1,8)'"
        raise ConfigError("hydra.sweeper.params", f"names nothing to search; {example}")
    return [word for key, word in params.items() if key not in given]


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
    override = parsed(word)
    # For options written as glob(...).
    override.config_loader = loader
    if not override.is_sweep_override():
        return [word]
    key, _, text = word.partition("=")
    interval = override.value()
    if isinstance(interval, IntervalSweep):
        return [f"{key}={interval.start}", f"{key}={interval.end}"]
    values = [f"{key}={value}" for value in override.sweep_string_iterator()]
    if not values:
        raise ConfigError(key, f"{text} is empty, so that nothing would run")
    if override.key_or_group in loader.list_groups(""):
        return values
    # Whether a number is accepted does not depend on which number.
    return list({_kind(value): value for value in reversed(values)}.values())[::-1]


def _kind(word: str) -> object:
    value = parsed(word).value()
    return type(value) if isinstance(value, (int, float, str)) else word
