"""What the rules of a configuration are made of: one error, and checks of single values."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from typing import Any

AXES = ("surge", "sway", "heave", "yaw")
MAX_STEPS = 1_000_000


class ConfigError(ValueError):
    """One impossible setting.

    Args:
        key: where, as on the command line.
        problem: what is wrong, and what would be right.
    """

    def __init__(self, key: str, problem: str):
        super().__init__(f"{key}: {problem}")
        self.key = key


def positive(value: float, key: str, zero: bool = False) -> None:
    """A finite number above zero, or not below it."""
    if not (math.isfinite(value) and (value > 0.0 or (zero and value == 0.0))):
        raise ConfigError(key, f"must be {'at least 0' if zero else 'greater than 0'}, got {value:g}")


def each(values: Sequence[float], key: str, length: int, zero: bool = False) -> None:
    """`length` numbers, all positive (or zero)."""
    finite(values, key, length)
    for value, axis in zip(values, AXES, strict=True):
        if value < 0.0 or (value == 0.0 and not zero):
            raise ConfigError(key, f"{axis} must be {'at least 0' if zero else 'greater than 0'}, got {value:g}")


def finite(values: Any, key: str, length: int) -> None:
    """A list of so many finite numbers."""
    numbers = isinstance(values, list) and all(isinstance(v, (int, float)) and math.isfinite(v) for v in values)
    if not numbers or len(values) != length:
        raise ConfigError(key, f"needs {length} finite numbers, got {values}")


def one_of(value: str, key: str, choices: Iterable[str]) -> None:
    """A known name; the nearest one is suggested."""
    choices = list(choices)
    if value not in choices:
        near = difflib.get_close_matches(value, choices, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ConfigError(key, f"{value!r} is none of {', '.join(choices)}{hint}")


def named(value: str, key: str, family: Iterable[str], here: Iterable[str]) -> None:
    """A name of the family, and one that belongs to the settings it stands in."""
    one_of(value, key, family)
    if value not in here:
        group = key.removesuffix(".name")
        raise ConfigError(key, f"{value!r} needs other settings than these; choose it with {group}={value}")


def steps(seconds: float, dt: float, key: str, least: int = 1) -> int:
    """How many steps a time is, which must be whole."""
    positive(seconds, key)
    if seconds / dt > MAX_STEPS:
        raise ConfigError(key, f"{seconds:g} s are more than {MAX_STEPS:,} steps of scenario.dt_s = {dt:g} s")
    count = round(seconds / dt)
    if count < least:
        raise ConfigError(key, f"{seconds:g} s is shorter than {least} steps of scenario.dt_s = {dt:g} s")
    if abs(count * dt - seconds) > 1e-9:
        raise ConfigError(key, f"{seconds:g} s is no whole number of steps of scenario.dt_s = {dt:g} s")
    return count
