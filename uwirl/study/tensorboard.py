"""TensorBoard scalars of a run; tags carry units."""

from __future__ import annotations

from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from uwirl.irl.policy_iteration import IterationRecord
from uwirl.motion.features import AXES, MotionBasis
from uwirl.snr.estimate import NAMES, ChannelEstimate
from uwirl.study.evaluation import Evaluation


class TensorBoard:
    """Writes what a run learns while it learns it.

    Args:
        folder: where the event files go.

    Attributes:
        continues: whether there are some of an interrupted run already.
    """

    def __init__(self, folder: Path):
        self.continues = folder.exists()
        self.writer = SummaryWriter(str(folder))

    def estimate(self, estimate: ChannelEstimate) -> None:
        """Stage 1's parameters, one point for each vehicle."""
        for name, tag in zip(NAMES, ("K_dB", "n", "zeta2_dB2", "varphi_m", "rho2_dB2"), strict=True):
            for vehicle, (value, std, identifiable) in enumerate(zip(*estimate.parameter(name), strict=True)):
                if identifiable:
                    self.writer.add_scalar(f"snr/{tag}", value, vehicle)
                    self.writer.add_scalar(f"snr/{tag}_std", std, vehicle)

    def iteration(self, record: IterationRecord, basis: MotionBasis) -> None:
        """Weights of the first learner over policy iterations."""
        for name, value in zip(basis.critic_names, record.critic[0].tolist(), strict=True):
            self.writer.add_scalar(f"critic/W_{name}", value, record.iteration)
        groups = zip(AXES, basis.actor_names, strict=True)
        names = [f"{axis}/W_{name}" for axis, features in groups for name in features]
        for name, value in zip(names, record.actor[0].tolist(), strict=True):
            self.writer.add_scalar(f"actor_{name}", value, record.iteration)
        self.writer.add_scalar("learning/weight_change", record.weight_change, record.iteration)
        self.writer.add_scalar("learning/vehicle_seconds_s", record.seconds, record.iteration)

    def cost_per_iteration(self, cost: list[float]) -> None:
        """J of each iterate from the mission's start."""
        for iteration, value in enumerate(cost, 1):
            self.writer.add_scalar("cost/total", value, iteration)

    def evaluation(self, evaluation: Evaluation, every: int = 10) -> None:
        """Capacity over the mission's time (step = ms) and the cost by term."""
        capacity = evaluation.chain_capacity[:, 0]
        for step in range(0, len(capacity), every):
            milliseconds = round(1000.0 * step * evaluation.trajectory.dt)
            self.writer.add_scalar("capacity/min_kbps", float(capacity[step]), milliseconds)
        for term, value in evaluation.cost_terms.items():
            self.writer.add_scalar(f"cost/{term}", float(value[0]), 0)

    def flush(self) -> None:
        """Write what is waiting, lest it be lost if the run is killed."""
        self.writer.flush()

    def close(self) -> None:
        self.writer.close()
