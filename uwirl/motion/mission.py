"""What the vehicles are to do on a channel: where each should be, and what it costs not to be there."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.targets import ChainTargets, mean_channel_targets
from uwirl.world.acoustics import Channel
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Mission:
    """One chain to be formed.

    Attributes:
        env: the worlds.
        channel: to count on: an estimate's when planning, the true one when judging.
        weights: of the running cost.
    """

    env: Relay
    channel: Channel
    weights: CostWeights = field(default_factory=CostWeights)

    @cached_property
    def targets(self) -> ChainTargets:
        """Where the vehicles carry most.

        Raises:
            NoTargetError: on this channel there is no such place.
        """
        return mean_channel_targets(self.env.scenario, self.channel)

    @cached_property
    def cost(self) -> RelayCost:
        """The running cost, which refers to these targets."""
        return RelayCost(self.channel, self.targets.neighbours, self.weights, self.env.vehicle.tau_max)
