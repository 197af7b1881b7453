"""Missions on the true channel, which tell what a policy is worth."""

from __future__ import annotations

import torch

from uwirl import build
from uwirl.config.schema import Config
from uwirl.irl.policy_iteration import IterationRecord
from uwirl.motion.planner import LearningPlanner
from uwirl.motion.policy import Policy
from uwirl.motion.targets import mean_channel_targets
from uwirl.snr.estimate import ChannelEstimate
from uwirl.study.evaluation import Evaluation, cost_of_weights, evaluate
from uwirl.world.relay import Relay


class Judge:
    """Flies policies on the true channel, from the scenario's start."""

    def __init__(self, config: Config, env: Relay):
        self.config = config
        self.env = env
        self.targets = mean_channel_targets(env.scenario, env.channel)
        self.cost = build.make_cost(config.cost, env.channel, self.targets, env.vehicle.tau_max)
        self.guard = build.make_guard(config)

    def fly(self, policy: Policy) -> Evaluation:
        return evaluate(self.env, policy, self.cost, self.targets, self.env.reset(), self.guard)

    def iterates(self, planner: LearningPlanner, records: list[IterationRecord]) -> tuple[Evaluation, list[float]]:
        """The start policy's mission, and J of every iterate."""
        learned = planner.policy.actor.weight.clone()
        planner.policy.actor.weight.copy_(planner.start_weights)
        start = self.fly(planner.lead(planner.policy))
        planner.policy.actor.weight.copy_(learned)
        weights = torch.stack([record.actor[: self.env.scenario.vehicles] for record in records])
        starts = self.env.scenario.start[None]
        costs = cost_of_weights(
            self.env, planner.policy, weights, self.cost, self.targets, starts, planner.lead, self.guard
        )
        return start, costs[:, 0].tolist()

    def baseline(self, estimate: ChannelEstimate) -> dict[str, Evaluation]:
        planner = build.make_planner(self.config, self.config.baseline, self.env)
        return {self.config.baseline.name: self.fly(planner.fit(self.env, estimate))}
