"""Planners from settings."""

from __future__ import annotations

from uwirl.builders.learning import irl_planner
from uwirl.builders.motion import make_cost, make_guard, make_guidance
from uwirl.config.make import make
from uwirl.config.schema import (
    Config,
    IrlConfig,
    PdConfig,
    PlannerConfig,
    PotentialFieldConfig,
    TrajectoryOptimizationConfig,
)
from uwirl.motion.baselines.guesses import Guess, guesses_on_the_map
from uwirl.motion.baselines.pd import PdPlanner
from uwirl.motion.baselines.potential_field import PotentialField
from uwirl.motion.baselines.trajectory_optimization import TrajectoryOptimization
from uwirl.motion.cost import RelayCost
from uwirl.motion.guidance import straight
from uwirl.motion.planner import IrlPlanner, Planner
from uwirl.motion.policy import Policy
from uwirl.motion.targets import ChainTargets, mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.world.acoustics import Channel
from uwirl.world.relay import Relay


def make_planner(config: Config, planner: PlannerConfig, env: Relay) -> Planner:
    """A planner with these settings; it learns one set of weights for each world of `env`."""

    if type(planner) is PlannerConfig:
        own: Planner = make(planner)
        return own

    def cost(channel: Channel, targets: ChainTargets) -> RelayCost:
        return make_cost(config.cost, channel, targets, env.vehicle.tau_max)

    if isinstance(planner, PdConfig):
        pd = PdPlanner(
            cost,
            planner.position_gain,
            planner.velocity_gain,
            planner.saturation_m,
            planner.calibration_s,
            make_guard(config),
            # A field leads by itself.
            straight if isinstance(planner, PotentialFieldConfig) else make_guidance(config),
        )
        return (
            PotentialField(pd, planner.repulsion, planner.reach_m) if isinstance(planner, PotentialFieldConfig) else pd
        )
    if isinstance(planner, TrajectoryOptimizationConfig):

        def guesses(worlds: Relay, running_cost: RelayCost, targets: ChainTargets) -> list[Guess]:
            return guesses_on_the_map(worlds, running_cost, targets, planner.speeds_mps, planner.intervals)

        return TrajectoryOptimization(cost, guesses, planner.intervals)
    assert isinstance(planner, IrlConfig)
    return irl_planner(config, planner, env, cost)


def policy_in(worlds: Relay, config: Config, planner: Planner, estimate: ChannelEstimate) -> Policy:
    """What a planner has found, in other worlds between the same nodes."""
    if not isinstance(planner, IrlPlanner):
        return planner.fit(worlds, estimate)
    targets = mean_channel_targets(worlds.scenario, estimate.channel)
    cost = make_cost(config.cost, estimate.channel, targets, worlds.vehicle.tau_max)
    return planner.guidance(worlds, cost, targets)(planner.policy)
