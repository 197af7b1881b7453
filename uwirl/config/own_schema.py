"""What names a class of the user's own."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass
class OwnConfig:
    target: str | None = None  # package.module.Class of your own, see docs/extending.md; null for uwirl's
    settings: dict[str, Any] = field(default_factory=dict)  # what it takes, by name


def values(section: OwnConfig) -> dict[str, Any]:
    """What stands in a section besides the class and its own settings: what uwirl's class is made from."""
    return {key: value for key, value in asdict(section).items() if key not in ("target", "settings")}
