"""From what was flown to what can be learned from: windows of integral reinforcement."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from uwirl.irl.bellman import BellmanOperator, Segment
from uwirl.motion.cost import RelayCost
from uwirl.motion.features import MotionBasis
from uwirl.world.trajectory import Trajectory


@dataclass(frozen=True)
class Window:
    """Windows of integral reinforcement: T = steps x dt, one every stride x dt."""

    steps: int
    stride: int


@dataclass(frozen=True)
class Recorder:
    """Turns trajectories into segments for the learner.

    Attributes:
        basis: features.
        operator: Bellman operator of that basis.
        cost: the learner's running cost.
        trim: tau_trim, [L, 4].
        window: integration windows.
        residual_floor: a window's equation is divided by its mean cost plus this share of the cost scale. Otherwise the
            windows far from the target, where cost is a hundred times larger, decide all weights alone.
        depth: of the water, m.
    """

    basis: MotionBasis
    operator: BellmanOperator
    cost: RelayCost
    trim: Tensor
    window: Window
    residual_floor: float
    depth: float

    def segment(self, x: Tensor, flown: Trajectory, dt: float) -> Segment:
        """Windows [S, L] of x [n + 1, L, d] under the held tau of a trajectory.

        Windows in which a vehicle touches surface or floor count for nothing: these push too.
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
