"""Words of a command line: what each is about."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

# Sections of the settings in which two runs with the same result may differ.
FREE = ("logging", "checkpoint", "resume")
# Two ways to say where vehicles start.
CHAIN = {"scenario.vehicles", "scenario.start"}
# Settings that are paths, `checkpoint` that of `uwirl-evaluate`.
PATHS = ("data", "resume", "init_from", "checkpoint", "hydra.run.dir", "hydra.sweep.dir")


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
    if keys & CHAIN:
        keys |= CHAIN
    return [override for override in overrides if key_of(override) not in keys]


def quoted(path: Path | str) -> str:
    """A path as Hydra reads it whatever is in it, like the = and , of a sweep's folders."""
    # It takes a backslash for one, but before a quote and at the end.
    return "'" + re.sub(r"(\\*)('|$)", lambda end: 2 * end[1] + (end[2] and "\\'"), str(path)) + "'"
