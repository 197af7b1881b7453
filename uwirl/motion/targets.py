"""Target positions of the vehicles for a channel: the estimate for planning, the truth for evaluation."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from uwirl.motion.link_frame import LinkFrame
from uwirl.world.acoustics import Channel
from uwirl.world.scenario import Scenario


class NoTargetError(ValueError):
    """The estimated channel has no best relay position."""


class ChainTargets(NamedTuple):
    """Target positions of the vehicles of a chain.

    Attributes:
        frame: link frames of the M vehicles.
        neighbours: source-side and destination-side neighbour of each target, in that target's frame, [M, 2, 3], m.
    """

    frame: LinkFrame
    neighbours: Tensor


def mean_channel_targets(scenario: Scenario, channel: Channel) -> ChainTargets:
    """Targets that maximise the worst link's mean capacity: M + 1 equal hops on the line from source to destination.

    The mean SNR depends on distance only and decreases with it. Shortening the longest hop therefore increases the
    capacity until all hops are equal.

    Raises:
        NoTargetError: the SNR does not decrease with distance over a hop, so this optimum does not exist.
    """
    M = scenario.vehicles
    span = scenario.destination - scenario.source
    hop = torch.linalg.vector_norm(span) / (M + 1)
    near, far = channel.mean_snr_dB(torch.stack([0.5 * hop, hop])[:, None])
    if not bool((near > far).all()):
        n = float(torch.as_tensor(channel.n).min())
        raise NoTargetError(
            f"estimator: the estimated SNR does not fall with distance (n = {n:.3g}), so "
            "there is no best relay position; use more sensors or more widely spread ones (scenario.sensors)"
        )
    fraction = torch.arange(1, M + 1, dtype=span.dtype, device=span.device) / (M + 1)
    bearing = torch.atan2(span[1], span[0]).expand(M)
    horizontal = torch.linalg.vector_norm(span[:2])
    step = torch.stack([horizontal, torch.zeros_like(horizontal), span[2]]) / (M + 1)
    neighbours = torch.stack([-step, step]).expand(M, 2, 3)
    return ChainTargets(LinkFrame(scenario.source + fraction[:, None] * span, bearing), neighbours)
