"""Planners from settings."""

from __future__ import annotations

from dataclasses import asdict

from uwirl.baselines.pd import PdPlanner
from uwirl.baselines.potential_field import PotentialField
from uwirl.baselines.trajectory_optimization import TrajectoryOptimization
from uwirl.builders.learning import irl_planner
from uwirl.builders.motion import make_cost, make_guard, make_guidance
from uwirl.builders.own import make_own
from uwirl.config.schema import (
    Config,
    IrlConfig,
    OwnPlannerConfig,
    PdConfig,
    PlannerConfig,
    PotentialFieldConfig,
    TrajectoryOptimizationConfig,
)
from uwirl.motion.planner import Planner
from uwirl.world.relay import Relay


def make_planner(config: Config, planner: PlannerConfig, env: Relay) -> Planner:
    """A planner with these settings."""
    if isinstance(planner, OwnPlannerConfig):
        own: Planner = make_own(planner, "baseline" if planner is config.baseline else "planner")
        return own
    values = asdict(planner)
    values.pop("name")
    if isinstance(planner, PdConfig):
        family = PotentialField if isinstance(planner, PotentialFieldConfig) else PdPlanner
        return family(make_cost(config.cost), make_guard(config, env), make_guidance(config), **values)
    if isinstance(planner, TrajectoryOptimizationConfig):
        return TrajectoryOptimization(make_cost(config.cost), **values)
    assert isinstance(planner, IrlConfig)
    return irl_planner(config, planner, env)
