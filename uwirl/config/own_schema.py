"""What names a class of the user's own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class OwnConfig:
    target: str | None = None  # package.module.Class of your own, see docs/extending.md; null for uwirl's
    settings: dict[str, Any] = field(default_factory=dict)  # what it takes, by name
