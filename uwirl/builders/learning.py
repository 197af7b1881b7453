"""The learning planner from settings."""

from __future__ import annotations

import math

from torch import Tensor

from uwirl.builders.motion import make_guard, make_guidance
from uwirl.config.make import make
from uwirl.config.schema import (
    BasisConfig,
    Config,
    ExperienceConfig,
    IrlConfig,
    LeastSquaresSolverConfig,
    LinkFrameBasisConfig,
    ParallelConfig,
    RlsSolverConfig,
    VirtualLinksConfig,
)
from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.least_squares import Regularisation
from uwirl.irl.policy_iteration import StoppingRule
from uwirl.irl.solvers import BatchLeastSquares, Bounds, ClassicalRls, Solver, ZRecursiveLeastSquares
from uwirl.motion.cost import RelayCost
from uwirl.motion.excitation import ArenaDraw, Excitation, PoseDraw
from uwirl.motion.experience import Parallel, VirtualLinks, Window
from uwirl.motion.features import ErrorBasis, LinkFrameBasis, MotionBasis
from uwirl.motion.geodesic_basis import GeodesicBasis, LearnedGeodesic
from uwirl.motion.guidance import Geodesic
from uwirl.motion.planner import CostFactory, ExperienceSource, IrlPlanner
from uwirl.world.relay import Relay


def irl_planner(config: Config, planner: IrlConfig, env: Relay, cost: CostFactory) -> IrlPlanner:
    dt = config.scenario.dt_s

    def solver(operator: BellmanOperator, weights: Tensor, bounds: Bounds) -> Solver:
        settings = config.solver
        if isinstance(settings, RlsSolverConfig):
            form = "paper" if settings.name == "rls_paper" else "exponential"
            return ClassicalRls(operator, weights, settings.kappa, settings.p0, form)
        assert isinstance(settings, LeastSquaresSolverConfig)
        family = ZRecursiveLeastSquares if settings.name == "z_rls" else BatchLeastSquares
        regularisation = Regularisation(settings.ridge, settings.prior)
        return family(operator, regularisation, bounds if settings.bounded else None)

    return IrlPlanner(
        make_cost=cost,
        make_basis=lambda running_cost: _basis(config, running_cost),
        make_solver=solver,
        experience=_experience(config),
        learners=1 if isinstance(config.experience, ParallelConfig) else env.worlds * env.scenario.vehicles,
        actor_sign=-1.0 if planner.actor_sign == "corrected" else 1.0,
        inertia_lower=tuple(planner.inertia_lower),
        start_gain=planner.start_gain,
        calibration_s=planner.calibration_s,
        window=Window(round(planner.window_s / dt), round(planner.stride_s / dt)),
        residual_floor=planner.residual_floor,
        updates=planner.updates,
        stopping=StoppingRule(planner.tolerance_weights, planner.max_time_s),
        guard=make_guard(config),
        guidance=_learned_geodesic(config) if config.basis.name == "geodesic" else make_guidance(config),
    )


def _learned_geodesic(config: Config) -> LearnedGeodesic:
    guidance = make_guidance(config)
    assert isinstance(guidance, Geodesic)
    return LearnedGeodesic(guidance.margin_m, guidance.map_settings)


def _basis(config: Config, cost: RelayCost) -> MotionBasis:
    basis = config.basis
    if type(basis) is BasisConfig:
        own: MotionBasis = make(basis, cost)
        return own
    if not isinstance(basis, LinkFrameBasisConfig):
        return ErrorBasis(velocity=basis.name == "error_velocity")
    if basis.name == "geodesic":
        return GeodesicBasis(cost, basis.length_scales_m, _learned_geodesic(config))
    return LinkFrameBasis(cost, basis.length_scales_m)


def _experience(config: Config) -> ExperienceSource:
    experience = config.experience
    excitation = Excitation(
        tuple(experience.excitation_rms),
        (experience.excitation_strength[0], experience.excitation_strength[1]),
        (experience.excitation_band_rad_s[0], experience.excitation_band_rad_s[1]),
    )
    pose = _pose_draw(config, experience)
    if isinstance(experience, ParallelConfig):
        return Parallel(experience.worlds, experience.leg_s, excitation, pose)
    assert isinstance(experience, VirtualLinksConfig)
    return VirtualLinks(experience.leg_s, experience.relabel, experience.relabel_time_s, excitation, pose)


def _pose_draw(config: Config, experience: ExperienceConfig) -> PoseDraw:
    """Virtual links reach 5 % further than half the real one, and than the mission's start in each direction."""
    source, destination = config.scenario.source_m, config.scenario.destination_m
    half = [(b - a) / 2.0 for a, b in zip(source, destination, strict=True)]
    bearing = math.atan2(half[1], half[0])
    c, s = math.cos(bearing), math.sin(bearing)
    errors = [[p - a - h for p, a, h in zip(eta[:3], source, half, strict=True)] for eta in config.scenario.start]
    along = 1.05 * max(math.hypot(*half), *(abs(c * x + s * y) for x, y, _ in errors))
    family = ArenaDraw if config.basis.name == "geodesic" else PoseDraw
    return family(
        along_m=along,
        across_m=max(experience.across_share * along, *(1.05 * abs(c * y - s * x) for x, y, _ in errors)),
        up_m=max(experience.up_m, *(1.05 * abs(z) for _, _, z in errors)),
        yaw_rad=experience.yaw_rad,
        near_share=experience.near_share,
        near_scale=experience.near_scale,
    )
