"""What may be run, but not without a word: sentences for the log and for `warnings` in metrics.json."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from uwirl.config.motion_schema import BarrierGuardConfig
from uwirl.config.schema import Config
from uwirl.config.validate import guarded_inertia

# Share of the inertia by which the barrier guard may be wrong.
INEXACT = 0.01


def cautions(config: Config) -> Iterator[str]:
    """What a validated configuration asks for that its user may not have meant."""
    safety, scenario = config.safety, config.scenario
    if isinstance(safety, BarrierGuardConfig):
        for (axis, inertia), assumed in zip(guarded_inertia(config).items(), safety.inertia_kg, strict=False):
            if abs(assumed - inertia) > INEXACT * inertia:
                there = f"{assumed:g} kg in {axis}, where the vehicle has {inertia:g} kg"
                yield f"safety.inertia_kg assumes {there}: the guard guarantees nothing"
    ends = list(zip(scenario.source_m, scenario.destination_m, strict=True))
    along = [sum(x * (b - a) for x, (a, b) in zip(eta[:3], ends, strict=True)) for eta in scenario.start]
    length = sum((b - a) ** 2 for a, b in ends)
    for i, (one, next_one) in enumerate(pairwise(along)):
        # Less than a hundredth of the link is beside each other.
        if one - next_one > 0.01 * length:
            order = f"vehicle {i + 1} starts nearer to the source than vehicle {i}, but its place is farther from it"
            yield f"scenario.start: {order}; their paths may cross, unless starts stand in the order of the chain"
