"""What stage 2 is made of, from settings: cost, guard, guidance."""

from __future__ import annotations

from dataclasses import asdict

from uwirl.config.schema import (
    BarrierGuardConfig,
    Config,
    CostConfig,
    EnergyGuardConfig,
    GeodesicConfig,
    GuardConfig,
    PrintedCostConfig,
)
from uwirl.motion.avoidance import Avoidance, Printed, remark_2, smooth
from uwirl.motion.barrier import BarrierGuard
from uwirl.motion.cost import CostWeights
from uwirl.motion.guidance import Geodesic, Guidance, Straight
from uwirl.motion.safety import EnergyGuard, Limits, Unguarded
from uwirl.study.evaluation import Evaluator
from uwirl.world.agent import Guard
from uwirl.world.relay import Relay


def make_cost(config: CostConfig) -> CostWeights:
    """Weights of the running cost."""
    avoidance: Avoidance = smooth
    if isinstance(config, PrintedCostConfig):
        avoidance = Printed(*remark_2(config.left_m, config.right_m, config.kappa_1, config.kappa_2))
    return CostWeights(config.beta_1, config.beta_2, config.yaw_weight, config.R, avoidance)


def make_guard(config: Config, env: Relay) -> Guard:
    """What stands between agent and thrusters."""
    settings = asdict(config.safety)
    settings.pop("name")
    if isinstance(config.safety, BarrierGuardConfig):
        return BarrierGuard(Limits.of(env), **settings)
    return EnergyGuard(Limits.of(env), **settings) if isinstance(config.safety, EnergyGuardConfig) else Unguarded()


def make_guidance(config: Config) -> Guidance:
    """How missions are led to their targets."""
    guidance = config.guidance
    if not isinstance(guidance, GeodesicConfig):
        return Straight()
    return Geodesic(
        guidance.gain,
        guidance.lateral_damping,
        guidance.heading_stiffness,
        guidance.heading_damping,
        guidance.spacing_m,
        guidance.exponent,
        guidance.hard_clearance_m,
        config.safety.margin_m if isinstance(config.safety, GuardConfig) else 0.0,
    )


def make_evaluator(config: Config, env: Relay) -> Evaluator:
    """Of missions in these worlds."""
    return Evaluator(env, make_cost(config.cost), make_guard(config, env))
