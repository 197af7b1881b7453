"""A mission: target positions of the vehicles for a channel, and the running cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.targets import ChainTargets, mean_channel_targets
from uwirl.world.acoustics import Channel
from uwirl.world.relay import Relay


@dataclass(frozen=True)
class Mission:
    """The task to form one relay chain.

    Attributes:
        env: the worlds.
        channel: estimated channel for planning, true channel for evaluation.
        weights: weights of the running cost.
    """

    env: Relay
    channel: Channel
    weights: CostWeights = field(default_factory=CostWeights)

    @cached_property
    def targets(self) -> ChainTargets:
        """Positions of the vehicles with the largest chain capacity.

        Raises:
            NoTargetError: this channel has no such positions.
        """
        return mean_channel_targets(self.env.scenario, self.channel)

    @cached_property
    def cost(self) -> RelayCost:
        """The running cost relative to these targets."""
        return RelayCost(self.channel, self.targets.neighbours, self.weights, self.env.vehicle.tau_max)
