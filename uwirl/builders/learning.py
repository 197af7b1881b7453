"""The learning planner from settings."""

from __future__ import annotations

from dataclasses import asdict

from uwirl.builders.motion import make_cost, make_guard, make_guidance
from uwirl.builders.own import make_own
from uwirl.config.schema import (
    Config,
    IrlConfig,
    LeastSquaresSolverConfig,
    LinkFrameBasisConfig,
    OwnBasisConfig,
    ParallelConfig,
    RlsSolverConfig,
)
from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.classical_rls import ClassicalRls
from uwirl.irl.solvers import BatchLeastSquares, Bounds, Solver, ZRecursiveLeastSquares
from uwirl.motion.cost import RelayCost
from uwirl.motion.experience import ExperienceSource, Parallel, VirtualLinks
from uwirl.motion.features import ErrorBasis, LinkFrameBasis, MotionBasis
from uwirl.motion.geodesic_basis import GeodesicBasis
from uwirl.motion.guidance import Geodesic
from uwirl.motion.irl_planner import IrlPlanner
from uwirl.motion.route_view import LearnedGeodesic
from uwirl.world.relay import Relay


def irl_planner(config: Config, planner: IrlConfig, env: Relay) -> IrlPlanner:
    def solver(operator: BellmanOperator, bounds: Bounds) -> Solver:
        settings = config.solver
        if isinstance(settings, RlsSolverConfig):
            form = "paper" if settings.name == "rls_paper" else "exponential"
            return ClassicalRls(operator, None, settings.kappa, settings.p0, form)
        assert isinstance(settings, LeastSquaresSolverConfig)
        family = ZRecursiveLeastSquares if settings.name == "z_rls" else BatchLeastSquares
        return family(operator, bounds, settings.ridge, settings.prior, settings.bounded)

    values = asdict(planner)
    values.pop("name")
    return IrlPlanner(
        cost=make_cost(config.cost),
        basis=lambda running_cost: _basis(config, running_cost),
        solver=solver,
        experience=_experience(config),
        guard=make_guard(config, env),
        guidance=_learned_geodesic(config) if config.basis.name == "geodesic" else make_guidance(config),
        **values,
    )


def _experience(config: Config) -> ExperienceSource:
    values = asdict(config.experience)
    values.pop("name")
    return Parallel(**values) if isinstance(config.experience, ParallelConfig) else VirtualLinks(**values)


def _learned_geodesic(config: Config) -> LearnedGeodesic:
    guidance = make_guidance(config)
    assert isinstance(guidance, Geodesic)
    return LearnedGeodesic(guidance.margin_m, guidance.map_settings)


def _basis(config: Config, cost: RelayCost) -> MotionBasis:
    basis = config.basis
    if isinstance(basis, OwnBasisConfig):
        own: MotionBasis = make_own(basis, "basis", cost)
        return own
    if not isinstance(basis, LinkFrameBasisConfig):
        return ErrorBasis(velocity=basis.name == "error_velocity")
    if basis.name == "geodesic":
        return GeodesicBasis(cost, basis.length_scales_m, _learned_geodesic(config))
    return LinkFrameBasis(cost, basis.length_scales_m)
