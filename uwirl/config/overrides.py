"""Words of a command line: what each is about."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

# Sections of the settings in which two runs with the same result may differ.
FREE = ("logging", "checkpoint", "resume")


def key_of(override: str) -> str:
    """`planner` of planner=irl and of +planner.x=1: the section of the settings that an override is about."""
    return override.split("=", 1)[0].lstrip("+~")


def section_of(override: str) -> str:
    """`planner` of planner.x=1, `hydra` of hydra/launcher=joblib."""
    return key_of(override).split(".")[0].split("/")[0]


def effective(overrides: Iterable[str]) -> list[str]:
    """Those that change the result, by which jobs of a sweep are told apart."""
    return [override for override in overrides if section_of(override) not in FREE]


def without(overrides: Iterable[str], others: Sequence[str]) -> list[str]:
    """Overrides whose keys none of some others has, which then take their place."""
    keys = {key_of(other) for other in others}
    return [override for override in overrides if key_of(override) not in keys]


def quoted(path: Path) -> str:
    """A path as Hydra reads it whatever is in it, like the = and , of a sweep's folders."""
    return "'" + str(path).replace("\\", "\\\\").replace("'", "\\'") + "'"


def unquoted(text: str) -> str:
    """A path that may have been quoted for Hydra."""
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text
