"""The settings of planner=irl."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from uwirl.irl.bellman import BellmanOperator
from uwirl.irl.solvers import Bounds, Solver, ZRecursiveLeastSquares
from uwirl.motion.cost import CostWeights, RelayCost
from uwirl.motion.experience import ExperienceSource, VirtualLinks
from uwirl.motion.features import LinkFrameBasis, MotionBasis
from uwirl.motion.guidance import Geodesic, Guidance
from uwirl.motion.vehicle_model import Fossen, Regressor
from uwirl.world.agent import Guard


def z_rls(operator: BellmanOperator, bounds: Bounds) -> Solver:
    """solver=z_rls: exact and recursive, with bounds that keep the actor a damped convex potential."""
    return ZRecursiveLeastSquares(operator, bounds, ridge=1e-7, prior=1e-3)


@dataclass(frozen=True)
class IrlSettings:
    """Settings of learning; the learned weights are in the state of a `Learning`.

    Attributes:
        cost: weights of the running cost.
        basis: function of a running cost, returns the features of critic and actor.
        solver: function of the Bellman operator and the actor's bounds, returns the solver.
        experience: source of experience.
        guard: guard between policy and thrusters while learning; an EnergyGuard if None.
        guidance: guidance to the target in missions; vehicles fly straight to virtual links.
        inertia_lower: lower bound of the inertia of each axis, kg, kg m^2: the only given fact about the dynamics.
        start_gain: scales the start policy.
        calibration_s: duration of the calibration hover, s; it counts as vehicle time.
        window_s: T of the integration windows, s.
        stride_s: time between the beginnings of two windows, s.
        residual_floor: see Recorder.
        updates: policy iterations after each leg.
        actor_sign: "corrected", or "printed" as in the paper, which fails.
        tolerance_weights: epsilon_3, relative change of the weights at which learning stops.
        tolerance_inverse_capacity: epsilon_4, change of 1/C that counts as converged, s/kbit.
        max_time_s: T_max,2, largest vehicle time, s.
        model_time_s: vehicle time from which the model for flights along routes is identified, s.
        model_window_s: of the integrals of one row of that identification, s.
        most_doubt: largest standard error of an inertia, as a share of it, with which that model is flown.
        regressor: structure of that model.
    """

    cost: CostWeights = field(default_factory=CostWeights)
    basis: Callable[[RelayCost], MotionBasis] = LinkFrameBasis
    solver: Callable[[BellmanOperator, Bounds], Solver] = z_rls
    experience: ExperienceSource = field(default_factory=VirtualLinks)
    guard: Guard | None = None
    guidance: Guidance = field(default_factory=Geodesic)
    inertia_lower: Sequence[float] = (12.0, 12.0, 12.0, 0.2)
    start_gain: float = 1.0
    calibration_s: float = 14.0
    window_s: float = 0.5
    stride_s: float = 0.25
    residual_floor: float = 0.15
    updates: int = 4
    actor_sign: str = "corrected"
    tolerance_weights: float = 1e-3
    tolerance_inverse_capacity: float = 1e-4
    max_time_s: float = 600.0
    model_time_s: float = 64.0
    model_window_s: float = 1.0
    most_doubt: float = 0.1
    regressor: Regressor = field(default_factory=Fossen)

    @property
    def sign(self) -> float:
        """Sign of the actor's part in the Bellman equation."""
        return -1.0 if self.actor_sign == "corrected" else 1.0
