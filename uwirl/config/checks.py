"""What schemas and rules are made of: one error, sections that know their rules, rules of single values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar

from omegaconf import MISSING

from uwirl.config.suggestions import did_you_mean, listed, similar

AXES = ("surge", "sway", "heave", "yaw")
MAX_STEPS = 1_000_000
# Keys of a section that its object is not made from.
APART = ("name", "target", "settings", "robust")
# What is wrong with a value, or None.
Rule = Callable[[Any], str | None]


class ConfigError(ValueError):
    """One impossible setting.

    Args:
        key: where, as on the command line.
        problem: what is wrong, and what would be right.
    """

    def __init__(self, key: str, problem: str):
        super().__init__(f"{key}: {problem}")
        self.key = key


@dataclass
class Section:
    """Settings that know their rules: those of one value stand at its field, by `ruled`, the others in `problems`."""

    def check(self, key: str) -> None:
        """Check every rule that this section alone can break.

        Args:
            key: of the section, dotted; empty for the whole configuration.

        Raises:
            ConfigError: the first that is broken.
        """
        prefix = f"{key}." if key else ""
        for setting in dataclasses.fields(self):
            value, name = getattr(self, setting.name), prefix + setting.name
            rule: Rule | None = setting.metadata.get("rule")
            problem = None if rule is None or value is None else rule(value)
            if problem:
                raise ConfigError(name, problem)
            parts = enumerate(value) if isinstance(value, list) else ()
            for at, part in ((name, value), *((f"{name}.{i}", item) for i, item in parts)):
                if isinstance(part, Section):
                    part.check(at)
        for name, problem in self.problems():
            raise ConfigError(prefix + name, problem)

    def problems(self) -> Iterator[tuple[str, str]]:
        """Rules between values of this section: a key, and what is wrong with it. Single values obey theirs by then."""
        yield from ()


@dataclass
class MadeConfig(Section):
    """What `uwirl.config.make` makes an object from.

    Attributes:
        family: what is made, which is also the group of its options.
        names: those of uwirl's options with these settings; none where any name, or no name, will do.
        files: every schema that files of a group name in their defaults list, by group and name.
    """

    target: str | None = None  # package.module.Class of uwirl, or of your own: docs/extending.md
    settings: dict[str, Any] = field(default_factory=dict)  # what a class of your own takes, by name

    family: ClassVar[str] = ""
    names: ClassVar[tuple[StrEnum, ...]] = ()
    files: ClassVar[dict[tuple[str, str], type]] = {}

    def __init_subclass__(cls, family: str = "", names: tuple[StrEnum, ...] = (), file: str = "") -> None:
        cls.family, cls.names = family or cls.family, names
        if file:
            cls.files[cls.family, file] = cls

    def values(self) -> dict[str, Any]:
        """What the object is made from besides `settings`, by name."""
        return {name: value for name, value in dataclasses.asdict(self).items() if name not in APART}

    def check(self, key: str) -> None:
        """As every section; a name must be that of an option with these settings."""
        name = getattr(self, "name", None)
        if self.names and name not in self.names:
            group = self.family if key == self.family else f"{self.family}@{key}"
            other = f"{name!r} needs other settings than these; choose it with {group}={name}"
            raise ConfigError(f"{key}.name", unlike(str(name), type(self.names[0])) or other)
        super().check(key)


def ruled(rule: Rule, default: Any = MISSING) -> Any:
    """A field whose value, unless it is null, must obey a rule."""
    metadata = {"rule": rule}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def positive(value: float) -> str | None:
    """Finite and above zero."""
    return None if math.isfinite(value) and value > 0.0 else f"must be greater than 0, got {value:g}"


def not_negative(value: float) -> str | None:
    """Finite and not below zero."""
    return None if math.isfinite(value) and value >= 0.0 else f"must be at least 0, got {value:g}"


def beyond_zero(value: float) -> str | None:
    """Above zero, infinity too."""
    return None if value > 0.0 else f"must be greater than 0, got {value:g}"


def finite(value: float) -> str | None:
    """A number that is one."""
    return None if math.isfinite(value) else f"must be finite, got {value}"


def at_least(least: int) -> Rule:
    """No less than that."""
    return lambda value: None if value >= least else f"must be at least {least}, got {value}"


def between(low: float, high: float) -> Rule:
    """Within the closed interval."""
    return lambda value: None if low <= value <= high else f"must lie in [{low:g}, {high:g}], got {value:g}"


def share(value: float) -> str | None:
    """A part of a whole."""
    return None if 0.0 <= value <= 1.0 else f"is a share between 0 and 1, got {value:g}"


def valid_seed(value: int) -> str | None:
    """What torch takes for one."""
    return None if 0 <= value < 2**63 else f"must lie in [0, 2^63), got {value}"


def numbers(length: int, sign: Rule | None = None) -> Rule:
    """A list of so many finite numbers, of a vehicle's axes if each must obey a rule."""

    def rule(values: Any) -> str | None:
        numeric = isinstance(values, list) and all(isinstance(v, (int, float)) and math.isfinite(v) for v in values)
        if not numeric or len(values) != length:
            return f"needs {length} finite numbers, got {values}"
        found = [(axis, sign(value)) for value, axis in zip(values, AXES, strict=False)] if sign else []
        return next((f"{axis} {problem}" for axis, problem in found if problem), None)

    return rule


def low_high(values: list[float]) -> str | None:
    """Two ends, neither of them negative."""
    problem = numbers(2)(values)
    if problem or 0.0 <= values[0] <= values[1]:
        return problem
    return f"must be [low, high] with 0 <= low <= high, got {values}"


def unlike(value: str, names: Iterable[str]) -> str | None:
    """What is wrong with a name that is none of some; the nearest one is suggested."""
    names = [str(name) for name in names]
    return None if value in names else f"{value!r} is none of {listed(names)}{did_you_mean(similar(value, names, 1))}"


def in_steps(seconds: float, dt: float, least: int = 1) -> str | None:
    """What is wrong with a time that must be a whole number of steps, at least so many."""
    if positive(seconds):
        return positive(seconds)
    if seconds / dt > MAX_STEPS:
        return f"{seconds:g} s are more than {MAX_STEPS:,} steps of scenario.dt_s = {dt:g} s"
    if round(seconds / dt) < least:
        return f"{seconds:g} s is shorter than {least} steps of scenario.dt_s = {dt:g} s"
    if abs(round(seconds / dt) * dt - seconds) > 1e-9:
        return f"{seconds:g} s is no whole number of steps of scenario.dt_s = {dt:g} s"
    return None
