"""From flown trajectories to the learner's data: windows of integral reinforcement."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.motion.cost import RelayCost
from uwirl.motion.features import MotionBasis
from uwirl.world.trajectory import Trajectory


@dataclass(frozen=True)
class Window:
    """Windows of integral reinforcement: T = steps x dt, a new one begins every stride x dt."""

    steps: int
    stride: int


@dataclass(frozen=True)
class Recorder:
    """Turns trajectories into segments for the learner.

    Attributes:
        basis: features of critic and actor.
        operator: Bellman operator of this basis.
        cost: the learner's running cost.
        trim: tau_trim, [L, 4].
        window: integration windows.
        residual_floor: a window's equation is divided by its mean cost plus this fraction of the cost scale. Otherwise
            windows far from the target, with a hundred times the cost, would dominate the fit.
        depth: water depth, m.
    """

    basis: MotionBasis
    operator: BellmanOperator
    cost: RelayCost
    trim: Tensor
    window: Window
    residual_floor: float
    depth: float

    def segment(self, x: Tensor, flown: Trajectory, dt: float) -> Segment:
        """Windows [S, L] of x [n + 1, L, d] and the held tau of a trajectory.

        Windows in which a vehicle touches surface or floor have zero weight, because these exert forces too.
        """
        segment = self.operator.segment(
            self.basis.critic(x),
            self.basis.actor(x),
            flown.tau.flatten(1, 2) - self.trim,
            self.basis.state_cost(self.cost, x),
            dt,
            self.window.steps,
            self.window.stride,
        )
        mean_cost = segment.cost / (self.window.steps * dt)
        z = flown.components[:, 2].flatten(1)
        afloat = (z < 0.0) & (z > -self.depth)
        counts = afloat.unfold(0, self.window.steps + 1, self.window.stride).all(-1)
        return segment.weighted(counts / (mean_cost + self.residual_floor * self.cost.scale.mean()))
