"""The jobs of a multirun that show whether its keys and types are right, before any of them runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep

from uwirl.config.groups import parsed


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
