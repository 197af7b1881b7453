"""How much is computed at once."""

from __future__ import annotations

import torch

# On a GPU a call costs a launch, however little it computes.
LARGER = 16


def at_once(count: int, device: torch.device) -> int:
    """Rows that are computed together: `count`, which suits the caches and memory of a CPU, and more elsewhere."""
    return count if device.type == "cpu" else LARGER * count
