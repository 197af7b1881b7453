"""What was probably meant: near names, in words."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence

LISTED = 24


def similar(name: str, names: Iterable[str], most: int = 3) -> list[str]:
    """The nearest of `names`: but for case, then beginnings, then by difflib's ratio."""
    lowered = {candidate.lower(): candidate for candidate in reversed(list(names))}
    name = name.lower()
    if name in lowered:
        return [lowered[name]]
    found = sorted(c for c in lowered if name and (c.startswith(f"{name}_") or name.startswith(f"{c}_")))
    found += difflib.get_close_matches(name, lowered, most, 0.6)
    return [lowered[candidate] for candidate in dict.fromkeys(found)][:most]


def did_you_mean(names: Sequence[str]) -> str:
    return f"; did you mean {' or '.join(repr(name) for name in names)}?" if names else ""


def listed(names: Iterable[str]) -> str:
    """Names in one line, the first few of many."""
    names = list(names)
    return ", ".join(names[:LISTED]) + (", ..." if len(names) > LISTED else "")


def nearest_keys(key: str, siblings: Sequence[str], everywhere: Sequence[str]) -> list[str]:
    """What may have been meant by a dotted key that is not there.

    Args:
        key: as it was given.
        siblings: names that its section has.
        everywhere: dotted keys of the whole configuration.
    """
    section, _, leaf = key.rpartition(".")
    prefix = f"{section}." if section else ""
    # The same name in another section, the nearest section first.
    near = [name for name in everywhere if name.rpartition(".")[2].lower() == leaf.lower()]
    near.sort(key=lambda name: not name.startswith(prefix))
    near += [prefix + name for name in similar(leaf, siblings)]
    return list(dict.fromkeys(near or similar(key, everywhere, 1)))[:3]
