"""Colours of vehicles and groups, which colour-blind people can distinguish."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Okabe and Ito's, without black and the yellow that white paper hides.
BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
DISTINCT = (BLUE, ORANGE, GREEN, PURPLE, AMBER, SKY)
# Anchors of viridis without its yellow end, for more lines than DISTINCT has.
ALONG = ("#440154", "#3B528B", "#21918C", "#5EC962", "#BDDF26")


def colours_of(count: int) -> NDArray:
    """RGB of each of `count` lines, [count, 3], in 0..1: distinct ones for at most six, else in order."""
    few = count <= len(DISTINCT)
    anchors = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in (DISTINCT if few else ALONG)])
    if few:
        return anchors[:count] / 255.0
    place = np.linspace(0.0, len(anchors) - 1.0, count)
    return np.stack([np.interp(place, range(len(anchors)), channel) for channel in anchors.T], -1) / 255.0
